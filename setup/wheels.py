# SPDX-License-Identifier: Apache-2.0
"""Make the ROS wheels in the environment a full ament prefix: include paths, `local_setup`, the stand-in `ros2`."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from setup.layout import Layout
from setup.venv import clean_environment

# The wheels' exported CMake targets name the folders of the machine that they were built on.
STALE_PYTHON = re.compile(r"/opt/python/cp\d+-cp\d+\w*/include/python3\.\d+\w*")
STALE_NUMPY = re.compile(r"/opt/python/cp\d+-cp\d+\w*/lib/python3\.\d+\w*/site-packages/numpy/_core/include")

# Sourced by install/setup.bash, which colcon chains to every ament prefix that it was built on.
LOCAL_SETUP = """\
# Puts the hydro environment first on the search paths; sourcing it twice changes nothing.
_hydro_prepend() {{
  eval "_hydro_old=\\${{$1:-}}"
  case ":$_hydro_old:" in
    *":$2:"*) ;;
    *) eval "export $1=\\"$2${{_hydro_old:+:$_hydro_old}}\\"" ;;
  esac
  unset _hydro_old
}}
_hydro_prepend PATH "{prefix}/bin"
_hydro_prepend AMENT_PREFIX_PATH "{prefix}"
_hydro_prepend CMAKE_PREFIX_PATH "{prefix}"
unset -f _hydro_prepend
"""


def repair_text(text: str, python_include: str, numpy_include: str) -> str:
    """Return `text` with the two stale include folders replaced by this environment's."""
    text = STALE_NUMPY.sub(lambda _: numpy_include, text)
    return STALE_PYTHON.sub(lambda _: python_include, text)


def repair_include_paths(prefix: Path, python_include: str, numpy_include: str) -> int:
    """Repair the CMake files below `prefix`/share; returns how many changed (0 the second time)."""
    changed = 0
    for path in sorted(prefix.glob("share/*/cmake/*.cmake")):
        text = path.read_text()
        repaired = repair_text(text, python_include, numpy_include)
        if repaired != text:
            path.unlink()  # a hard link into uv's cache, which other environments share
            path.write_text(repaired)
            changed += 1
    return changed


def include_folders(layout: Layout) -> tuple[str, str]:
    """Return the (Python, numpy) include folders of the environment."""
    code = "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())"
    command = [str(layout.python), "-c", code]
    answer = subprocess.run(command, capture_output=True, text=True, check=True, env=clean_environment())
    python_include, numpy_include = answer.stdout.splitlines()
    return python_include, numpy_include


def write_local_setup(layout: Layout) -> None:
    """Give the environment the `local_setup` files that make it a prefix colcon can chain to."""
    text = LOCAL_SETUP.format(prefix=layout.venv)
    for suffix in ("sh", "bash"):
        (layout.venv / f"local_setup.{suffix}").write_text(text)


def install_stand_in(layout: Layout) -> None:
    """Put the stand-in `ros2` into the environment, run by the environment's Python."""
    source = Path(__file__).with_name("ros2.py").read_text()
    target = layout.venv / "bin" / "ros2"
    target.unlink(missing_ok=True)
    target.write_text(f"#!{layout.python}\n{source}")
    target.chmod(0o755)
