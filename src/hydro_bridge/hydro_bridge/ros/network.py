# SPDX-License-Identifier: Apache-2.0
"""How far nodes look for one another: on this machine only, unless the user says otherwise (network.md).

The one place for it is ROS's own variable, `RANGE`. LOCALHOST stops Fast DDS from multicasting, but not from listening
on all addresses: `PROFILES` does.
"""

from __future__ import annotations

import os
from importlib import resources

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
THIS_MACHINE = "LOCALHOST"


def stay_on_this_machine() -> None:
    """Set the environment of this process and of those it starts; before ROS is. What the user has set stays."""
    if os.environ.setdefault(RANGE, THIS_MACHINE) == THIS_MACHINE:
        profile = resources.files("hydro_bridge.ros") / "this_machine.xml"
        os.environ.setdefault(PROFILES, str(profile))
