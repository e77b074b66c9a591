# SPDX-License-Identifier: Apache-2.0
"""Build the packages with colcon."""

from __future__ import annotations

import shutil
from collections.abc import Mapping

from setup.layout import Layout
from setup.progress import run_logged


def build(layout: Layout, environment: Mapping[str, str]) -> None:
    """Build every package below `src/` into `install/`.

    Colcon runs on the environment's Python, whichever colcon it is: that Python is the one the executables start with.
    """
    command = [str(layout.python), "-m", "colcon", "--log-base", str(layout.root / "log"), "build"]
    command += ["--base-paths", str(layout.root / "src"), str(layout.root / "firmware")]
    command += ["--build-base", str(layout.root / "build")]
    command += ["--install-base", str(layout.install), "--symlink-install", "--metas", str(layout.root / "colcon.meta")]
    run_logged(command, layout.log("build"), environment)


def forget(layout: Layout) -> None:
    """Remove what was built for another environment: its interpreter and paths are written all over it."""
    for folder in (layout.root / "build", layout.install):
        shutil.rmtree(folder, ignore_errors=True)
