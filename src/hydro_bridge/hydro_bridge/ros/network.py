# SPDX-License-Identifier: Apache-2.0
"""Discovery range, transport and discovery time of the nodes (network.md).

On this machine only, unless the user says otherwise. The one place for it is ROS's own variable, `RANGE`. LOCALHOST
stops Fast DDS from multicasting, but not from listening on all addresses, and adds shared memory, in which a plant's
thread waits up to 333 ms for a newcomer (docs/decisions/0059-found-within-half-a-second.md). So with Fast DDS all of it
is said in `PROFILES`: UDP, the loopback interface, no multicast; and the middleware is told to take that as it is.
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
"""The range in which a middleware adds nothing of its own to what it is set to."""
_OLD_RANGE = "ROS_LOCALHOST_ONLY"  # goes before `RANGE` where it is set; deprecated


def stay_on_this_machine() -> None:
    """Restrict ROS to this machine, for this process and its children, before ROS starts; the user's own settings win.

    Raises
    ------
    UserError
        The middleware that the user has set is not installed.
    """
    if trouble := middleware.missing_middleware():
        raise UserError(trouble)
    here = os.environ.setdefault(RANGE, THIS_MACHINE) == THIS_MACHINE
    profile = str(resources.files("hydro_bridge.ros") / ("this_machine.xml" if here else "any_network.xml"))
    ours = os.environ.setdefault(PROFILES, profile) == profile
    if here and ours and get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        os.environ[RANGE] = AS_PROFILED  # the profile keeps to this machine
        os.environ.pop(_OLD_RANGE, None)
