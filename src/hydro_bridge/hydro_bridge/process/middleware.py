# SPDX-License-Identifier: Apache-2.0
"""Whether the middleware that the environment asks for is installed: ROS itself ends in its own words, or a traceback.

Imports nothing of ROS.
"""

from __future__ import annotations

import os
from pathlib import Path

RMW = "RMW_IMPLEMENTATION"
_INDEX = "share/ament_index/resource_index/rmw_typesupport"
_CHOOSER = "rmw_implementation"  # stands in the index, too, and is none


def missing() -> str:
    """Why no node can start here, in a sentence; empty where the middleware is there, or the default is meant."""
    wanted = os.environ.get(RMW, "")
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    installed = sorted({path.name for prefix in prefixes for path in (prefix / _INDEX).glob("*")} - {_CHOOSER})
    if not wanted or not installed or wanted in installed:
        return ""
    return f"{RMW} is {wanted}, which is not installed: unset it, or take {' or '.join(installed)}"
