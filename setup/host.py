# SPDX-License-Identifier: Apache-2.0
"""What the machine offers: a sourced ROS 2 Jazzy, a C++ compiler, the venv module."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from setup.progress import SetupError

# Set by the ROS wheels at start-up or by a sourced workspace; each would leak one environment into another.
FOREIGN = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "PYTHONHOME",
    "PYTHONPATH",
    "VIRTUAL_ENV",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)


def sourced_ros(environment: Mapping[str, str], venv: Path) -> Path | None:
    """Return the prefix of the ROS 2 Jazzy that is sourced here, or None.

    A sourced one sets `ROS_DISTRO` and `AMENT_PREFIX_PATH`, and has a `ros2` on PATH that is not our stand-in.

    Raises SetupError if another distribution is sourced: its libraries would mix with ours.
    """
    distribution = environment.get("ROS_DISTRO")
    if not distribution or not environment.get("AMENT_PREFIX_PATH"):
        return None
    if distribution != "jazzy":
        raise SetupError(
            f"ROS 2 {distribution} is sourced, but hydro needs Jazzy: source Jazzy, or open a shell without."
        )
    ros2 = shutil.which("ros2", path=_without(environment.get("PATH", ""), venv / "bin"))
    return Path(ros2).resolve().parent.parent if ros2 else None


def build_environment(environment: Mapping[str, str], venv: Path, ros: Path | None) -> dict[str, str]:
    """Return the environment to build in: the venv's tools first; with wheels the venv is the only ament prefix."""
    result = dict(environment)
    if ros is None:
        for name in FOREIGN:
            result.pop(name, None)
        result["AMENT_PREFIX_PATH"] = result["CMAKE_PREFIX_PATH"] = str(venv)
    path = _without(result.get("PATH", os.defpath), venv / "bin")
    result["PATH"] = os.pathsep.join([str(venv / "bin"), path])
    return result


def require_tools(ros: Path | None) -> None:
    """Check for what no wheel brings.

    Raises SetupError if the venv module, a C++ compiler or make is missing, or there are no ROS wheels for this
    machine.
    """
    if ros is None and (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise SetupError("the ROS wheels are for Linux on x86_64: install and source ROS 2 Jazzy, then run this again.")
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if importlib.util.find_spec("venv") is None or importlib.util.find_spec("ensurepip") is None:
        raise SetupError(f"Python's venv module is missing: `apt install python{version}-venv`, then run this again.")
    if not any(shutil.which(name) for name in (os.environ.get("CXX") or "c++", "g++", "clang++")):
        raise SetupError("no C++ compiler found: `apt install g++`, then run this again.")
    if shutil.which("make") is None:
        raise SetupError("make is missing: `apt install make`, then run this again.")


def _without(path: str, folder: Path) -> str:
    return os.pathsep.join(part for part in path.split(os.pathsep) if part and Path(part) != folder)
