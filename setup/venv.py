# SPDX-License-Identifier: Apache-2.0
"""The virtual environment and the pinned wheels in it."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from setup.host import FOREIGN
from setup.layout import Layout
from setup.progress import run_logged

PINS = ("constraints.txt", "requirements.txt", "requirements-build.txt", "requirements-dev.txt", "requirements-ros.txt")
"""Of `.venv`. It is filled in several calls, and all pins hold in each: none brings along what another one replaces."""

UV_VARIABLES = {
    "index-url": ("UV_DEFAULT_INDEX", " "),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "cert": ("SSL_CERT_FILE", " "),
}
"""Options of pip's configuration: uv's variable, and what separates its values."""

HINT = "Check the network and the pins, then run this again: what is installed stays. "


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


def create(layout: Layout, system_packages: bool, log: Path) -> None:
    """Make the environment again."""
    options = ["--clear", *(["--system-site-packages"] if system_packages else [])]
    run_logged([base_python(), "-m", "venv", *options, str(layout.venv)], log, clean_environment())


def install_uv(layout: Layout, log: Path) -> None:
    """Install the installer of all other wheels."""
    pins = str(layout.root / "requirements-setup.txt")
    command = [str(layout.python), "-m", "pip", "install", "--no-input", "--disable-pip-version-check", "-r", pins]
    run_logged(command, log, clean_environment(), HINT)


def install(layout: Layout, requirements: Sequence[str], log: Path) -> None:
    """Install requirements, files of such by their names among them, at the pinned versions."""
    words = [word for name in PINS for word in ("-c", str(layout.root / name))]
    for name in requirements:
        words += ["-r", str(layout.root / name)] if name.endswith(".txt") else [name]
    command = [str(layout.venv / "bin" / "uv"), "pip", "install", "--python", str(layout.python), *words]
    run_logged(command, log, uv_environment(layout), HINT)


def uv_environment(layout: Layout) -> dict[str, str]:
    """Return the environment for uv, with what pip is configured to: mirror, folders of wheels, certificates."""
    command = [str(layout.python), "-m", "pip", "config", "list"]
    answer = subprocess.run(command, capture_output=True, text=True, env=clean_environment(), check=False)
    result = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # the best version of all indexes, as pip
    for line in answer.stdout.splitlines():  # :env:.find-links='/opt/wheels', before those of files
        name, _, value = line.partition("=")
        if (option := name.rpartition(".")[2]) in UV_VARIABLES:
            variable, separator = UV_VARIABLES[option]
            result.setdefault(variable, separator.join(ast.literal_eval(value).split()))
    return {**result, **clean_environment()}


def downloads(log: Path) -> tuple[float, float]:
    """Return what uv downloaded, from its log: MB in wheels above 1 MiB, which it lists, and seconds with unpacking."""
    text = log.read_text() if log.exists() else ""
    sizes = re.findall(r"^Downloading .* \(([\d.]+)(KiB|MiB|GiB)\)$", text, re.MULTILINE)
    times = re.findall(r"^Prepared .* in (?:(\d+)m )?([\d.]+)(ms|s)$", text, re.MULTILINE)
    megabytes = sum(float(size) * {"KiB": 2**10, "MiB": 2**20, "GiB": 2**30}[unit] / 1e6 for size, unit in sizes)
    seconds = sum(60 * int(minutes or 0) + float(rest) * {"ms": 1e-3, "s": 1.0}[unit] for minutes, rest, unit in times)
    return megabytes, seconds


def _settings(path: Path) -> dict[str, str]:
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return {}
    return {key.strip(): value.strip() for key, _, value in (line.partition("=") for line in lines)}
