# SPDX-License-Identifier: Apache-2.0
"""The virtual environment: what the machine brings for it, how uv is configured, and the ROS wheels in it."""

from __future__ import annotations

import ast
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
INSTALLING = VENV / "hydro-installing"
"""There while uv installs: one that was ended leaves packages that the next cannot read."""
FOREIGN = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONHOME",
           "PYTHONPATH", "VIRTUAL_ENV", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")  # fmt: skip
"""Set by a sourced workspace or by the ROS wheels: each would leak one environment into another."""
UV_OPTIONS = {
    "index-url": ("UV_DEFAULT_INDEX", " "),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "cert": ("SSL_CERT_FILE", " "),
}
"""Options of pip's configuration: uv's variable, and what separates its values."""
# Sourced by install/setup.bash, which colcon chains to every ament prefix that it was built on.
LOCAL_SETUP = """\
# Puts the hydro environment first on the search paths; sourcing it twice changes nothing.
for _hydro in "PATH={prefix}/bin" "AMENT_PREFIX_PATH={prefix}" "CMAKE_PREFIX_PATH={prefix}"; do
  eval "_hydro_old=\\${{${{_hydro%%=*}}:-}}"
  case ":$_hydro_old:" in
    *":${{_hydro#*=}}:"*) ;;
    *) export "$_hydro${{_hydro_old:+:$_hydro_old}}" ;;
  esac
done
unset _hydro _hydro_old
"""


class SetupError(Exception):
    """What stopped the set-up, as one sentence for the person at the terminal."""


def sourced_ros(environment: Mapping[str, str]) -> Path | None:
    """Return the prefix of the ROS 2 Jazzy that is sourced here, or None.

    A sourced one sets `ROS_DISTRO` and `AMENT_PREFIX_PATH`, and has a `ros2` on PATH that is not our stand-in.

    Raises SetupError if another distribution is sourced: its libraries would mix with ours.
    """
    distribution = environment.get("ROS_DISTRO")
    if not distribution or not environment.get("AMENT_PREFIX_PATH"):
        return None
    if distribution != "jazzy":
        raise SetupError(f"ROS 2 {distribution} is sourced: source Jazzy, or open a shell without.")
    ros2 = shutil.which("ros2", path=_path(environment))
    return Path(ros2).resolve().parent.parent if ros2 else None


def variables(environment: Mapping[str, str], ros: Path | None) -> dict[str, str]:
    """Return the environment to install and build in: the venv's tools first; without `ros` its prefix alone."""
    result = {name: value for name, value in environment.items() if ros or name not in FOREIGN}
    if ros is None:
        result["AMENT_PREFIX_PATH"] = result["CMAKE_PREFIX_PATH"] = str(VENV)
    return {**result, "PATH": os.pathsep.join([str(VENV / "bin"), _path(environment)])}


def _path(environment: Mapping[str, str]) -> str:
    parts = environment.get("PATH", os.defpath).split(os.pathsep)
    return os.pathsep.join(part for part in parts if part and Path(part) != VENV / "bin")


def require_tools(ros: Path | None) -> None:
    """Raise SetupError if there are no ROS wheels for this machine, or something is missing that no wheel brings."""
    if ros is None and (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise SetupError("the ROS wheels are for Linux on x86_64: install and source ROS 2 Jazzy, then run this again.")
    if importlib.util.find_spec("ensurepip") is None:
        raise SetupError(f"python{sys.version_info.major}.{sys.version_info.minor}-venv is missing: install it by apt.")
    if not any(map(shutil.which, (os.environ.get("CXX") or "c++", "g++", "clang++"))):
        raise SetupError("there is no C++ compiler: `apt install g++`, then run this again.")


def is_usable(ros: Path | None) -> bool:
    """Say whether the virtual environment is whole, was made here, and of this Python."""
    try:
        lines = (VENV / "pyvenv.cfg").read_text().splitlines()
        made_here = str(VENV) in (VENV / "bin" / "pip").read_text()
    except OSError:
        return False
    wanted = {f"version = {platform.python_version()}", f"include-system-site-packages = {str(bool(ros)).lower()}"}
    return made_here and wanted <= set(lines) and PYTHON.exists() and not INSTALLING.exists()


def with_pip_configuration(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment for uv, with what pip is configured to: mirror, folders of wheels, certificates."""
    command = [str(PYTHON), "-m", "pip", "config", "list"]
    answer = subprocess.run(command, capture_output=True, text=True, env=dict(environment), check=False)
    result = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # the best version of all indexes, as pip
    for line in answer.stdout.splitlines():  # :env:.find-links='/opt/wheels', before those of files
        name, _, value = line.partition("=")
        if (option := name.rpartition(".")[2]) in UV_OPTIONS:
            variable, separator = UV_OPTIONS[option]
            result.setdefault(variable, separator.join(ast.literal_eval(value).split()))
    return {**result, **environment}


def adapt_wheels() -> None:
    """Make the ROS wheels in the environment a full ament prefix: include paths, `local_setup`, the stand-in `ros2`."""
    code = "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())"
    answer = subprocess.run([str(PYTHON), "-c", code], capture_output=True, text=True, check=True)
    repair_include_paths(VENV, *answer.stdout.splitlines())
    for suffix in ("sh", "bash"):
        (VENV / f"local_setup.{suffix}").write_text(LOCAL_SETUP.format(prefix=VENV))
    stand_in = VENV / "bin" / "ros2"
    stand_in.unlink(missing_ok=True)
    stand_in.write_text(f"#!{PYTHON}\n{Path(__file__).with_name('ros2.py').read_text()}")
    stand_in.chmod(0o755)


def repair_include_paths(prefix: Path, python_include: str, numpy_include: str) -> None:
    """Replace the folders of the machine that the wheels were built on in the CMake files below `prefix`/share."""
    folders = {r"lib/python3\.\d+\w*/site-packages/numpy/_core/include": numpy_include}
    folders[r"include/python3\.\d+\w*"] = python_include
    for path in prefix.glob("share/*/cmake/*.cmake"):
        text = repaired = path.read_text()
        for stale, folder in folders.items():
            repaired = re.sub(r"/opt/python/cp\d+-cp\d+\w*/" + stale, folder.replace("\\", r"\\"), repaired)
        if repaired != text:
            path.unlink()  # a hard link into uv's cache, which other environments share
            path.write_text(repaired)
