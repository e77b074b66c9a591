# SPDX-License-Identifier: Apache-2.0
"""Check that the middleware selected by the environment is installed; ROS itself would end in a traceback.

Imports no ROS package.
"""

from __future__ import annotations

import os
from pathlib import Path

RMW = "RMW_IMPLEMENTATION"
_INDEX = "share/ament_index/resource_index/rmw_typesupport"
_CHOOSER = "rmw_implementation"  # listed in the index as well, but not a middleware


def missing_middleware() -> str:
    """Return a sentence about why no node can start; empty if the middleware is installed or the default."""
    wanted = os.environ.get(RMW, "")
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    installed = sorted({path.name for prefix in prefixes for path in (prefix / _INDEX).glob("*")} - {_CHOOSER})
    if not wanted or not installed or wanted in installed:
        return ""
    return f"{RMW} is {wanted}, which is not installed: unset it, or take {' or '.join(installed)}"
