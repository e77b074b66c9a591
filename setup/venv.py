# SPDX-License-Identifier: Apache-2.0
"""The virtual environment and the pinned wheels in it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from setup.host import FOREIGN
from setup.layout import Layout
from setup.progress import run_logged


def base_python() -> str:
    """Return the interpreter that environments are made from, also when this one runs inside one."""
    return getattr(sys, "_base_executable", None) or sys.executable


def clean_environment() -> dict[str, str]:
    """Return this process's environment without what a sourced workspace or the ROS wheels put there."""
    return {name: value for name, value in os.environ.items() if name not in FOREIGN}


def is_usable(layout: Layout, system_packages: bool) -> bool:
    """Say whether the environment stands here, whole, and was made from this Python.

    One whose making was cut short has no pip; one that was moved with its checkout has a pip that names another place.
    """
    settings = _settings(layout.venv / "pyvenv.cfg")
    if settings.get("include-system-site-packages") != str(system_packages).lower():
        return False
    command = [str(layout.python), "-c", "import sys, pip; print(*sys.version_info[:3])"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, env=clean_environment(), check=False)
        belongs_here = str(layout.venv) in (layout.venv / "bin" / "pip").read_text()
    except OSError:
        return False
    return belongs_here and answer.stdout.split() == [str(part) for part in sys.version_info[:3]]


def create(layout: Layout, system_packages: bool) -> None:
    """Make the environment again."""
    options = ["--clear", *(["--system-site-packages"] if system_packages else [])]
    run_logged([base_python(), "-m", "venv", *options, str(layout.venv)], layout.log("venv"), clean_environment())


def requirement_files(layout: Layout, with_ros: bool, with_build_tools: bool) -> list[Path]:
    """Return the pin files that this machine needs."""
    names = ["requirements.txt", "requirements-dev.txt"]
    names += ["requirements-ros.txt"] if with_ros else []
    names += ["requirements-build.txt"] if with_build_tools else []
    return [layout.root / name for name in names]


def install(layout: Layout, files: list[Path]) -> None:
    """Install the pinned wheels."""
    options = [word for file in files for word in ("-r", str(file))] + ["-c", str(layout.root / "constraints.txt")]
    command = [str(layout.python), "-m", "pip", "install", "--no-input", "--disable-pip-version-check", *options]
    hint = "Check the network and the pins, then run this again: what is installed stays. "
    run_logged(command, layout.log("wheels"), clean_environment(), hint)


def _settings(path: Path) -> dict[str, str]:
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return {}
    return {key.strip(): value.strip() for key, _, value in (line.partition("=") for line in lines)}
