# SPDX-License-Identifier: Apache-2.0
"""Build the packages with colcon."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from setup.layout import Layout
from setup.progress import run_logged


def build(layout: Layout, environment: Mapping[str, str], packages: Sequence[str], log: Path) -> None:
    """Build these packages of `src/` and `firmware/` into `install/`; all where none is named.

    Colcon runs on the environment's Python, whichever colcon it is: that Python is the one the executables start with.
    """
    command = [str(layout.python), "-m", "colcon", "--log-base", str(layout.root / "log"), "build"]
    command += ["--base-paths", str(layout.root / "src"), str(layout.root / "firmware")]
    command += ["--build-base", str(layout.root / "build")]
    command += ["--install-base", str(layout.install), "--symlink-install", "--metas", str(layout.root / "colcon.meta")]
    command += ["--packages-select", *packages] if packages else []
    run_logged(command, log, environment)


def link_sources(layout: Layout) -> list[str]:
    """Link the Python packages into `build/` as colcon does, and return the folders to import them from."""
    folders = []
    for source in sorted(layout.root.glob("src/*/setup.py")):
        name = source.parent.name
        link = layout.root / "build" / name / name
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.exists():
            link.symlink_to(source.parent / name)
        folders.append(str(link.parent))
    return folders


def forget(layout: Layout) -> None:
    """Remove what was built for another environment: its interpreter and paths are written all over it."""
    for folder in (layout.root / "build", layout.install):
        shutil.rmtree(folder, ignore_errors=True)
