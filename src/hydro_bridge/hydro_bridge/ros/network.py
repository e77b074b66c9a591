# SPDX-License-Identifier: Apache-2.0
"""Discovery range, transport and discovery time of the nodes (network.md).

This machine only, unless the user chooses otherwise by ROS's own variable, `RANGE`. LOCALHOST stops Fast DDS from
multicasting, but not from listening on all addresses, and adds shared memory, in which a plant's thread waits up to
333 ms for a new participant (docs/decisions/0059-found-within-half-a-second.md). For Fast DDS everything is therefore
set in `PROFILES`: UDP, the loopback interface, no multicast; and the middleware is told to add nothing.
"""

from __future__ import annotations

import os
from importlib import resources

from rclpy.utilities import get_rmw_implementation_identifier

from hydro_bridge.errors import UserError
from hydro_bridge.process import middleware

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
THIS_MACHINE = "LOCALHOST"
AS_PROFILED = "SYSTEM_DEFAULT"
"""Range in which a middleware adds nothing to its configuration."""
_OLD_RANGE = "ROS_LOCALHOST_ONLY"  # takes precedence over `RANGE` if set; deprecated


def stay_on_this_machine() -> None:
    """Restrict ROS to this machine for this process and its children; call before ROS starts. The user's settings win.

    Raises
    ------
    UserError
        The middleware that the user selected is not installed.
    """
    if trouble := middleware.missing_middleware():
        raise UserError(trouble)
    here = os.environ.setdefault(RANGE, THIS_MACHINE) == THIS_MACHINE
    profile = str(resources.files("hydro_bridge.ros") / ("this_machine.xml" if here else "any_network.xml"))
    ours = os.environ.setdefault(PROFILES, profile) == profile
    if here and ours and get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        os.environ[RANGE] = AS_PROFILED  # the profile restricts it to this machine
        os.environ.pop(_OLD_RANGE, None)
