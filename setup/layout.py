# SPDX-License-Identifier: Apache-2.0
"""Where the set-up reads and writes, all below the checkout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Layout:
    """Paths of one checkout."""

    root: Path

    @property
    def venv(self) -> Path:
        """The virtual environment; also the ament prefix of the ROS wheels."""
        return self.root / ".venv"

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return self.venv / "bin" / "python"

    @property
    def install(self) -> Path:
        """Colcon's install folder, with `setup.bash`."""
        return self.root / "install"

    @property
    def wheels_stamp(self) -> Path:
        """Digest of what the environment was made from; gone when the environment is deleted."""
        return self.venv / "hydro-setup.stamp"

    @property
    def checks_stamp(self) -> Path:
        """Digest of what the checks and tests need on top; gone when the environment is deleted."""
        return self.venv / "hydro-checks.stamp"

    @property
    def build_stamp(self) -> Path:
        """Digest of what the packages were built from; gone when `install/` is deleted."""
        return self.install / "hydro-setup.stamp"

    def kernels_stamp(self, main_job: bool) -> Path:
        """What the kernels, all or the main job's, were made from and where they are; gone with `.cache/`."""
        return self.root / ".cache" / "setup" / ("kernels-main-job.json" if main_job else "kernels.json")

    def log(self, name: str) -> Path:
        """Where the output of a step goes."""
        return self.root / ".cache" / "setup" / f"{name}.log"

    @property
    def lock(self) -> Path:
        """Held while a set-up works, so that two at a time take turns."""
        return self.root / ".cache" / "setup" / "lock"


HERE = Layout(root=Path(__file__).resolve().parent.parent)
