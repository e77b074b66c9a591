# SPDX-License-Identifier: Apache-2.0
"""How far nodes look for one another, and how soon they find each other (network.md).

On this machine only, unless the user says otherwise. The one place for it is ROS's own variable, `RANGE`. LOCALHOST
stops Fast DDS from multicasting, but not from listening on all addresses: `PROFILES` does. Whatever the range, nodes
announce themselves every 0.25 s: a plant's thread waits up to 333 ms for a newcomer that has idled for more than a
second (docs/decisions/0059-found-within-half-a-second.md).
"""

from __future__ import annotations

import os
from importlib import resources

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
THIS_MACHINE = "LOCALHOST"


def stay_on_this_machine() -> None:
    """Set the environment of this process and of those it starts; before ROS is. What the user has set stays."""
    here = os.environ.setdefault(RANGE, THIS_MACHINE) == THIS_MACHINE
    profile = resources.files("hydro_bridge.ros") / ("this_machine.xml" if here else "any_network.xml")
    os.environ.setdefault(PROFILES, str(profile))
