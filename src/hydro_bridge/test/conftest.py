# SPDX-License-Identifier: Apache-2.0
"""What several tests need: states with known content, a pseudo-terminal pair."""

from __future__ import annotations

import os
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.signals import STATE_DTYPE, STATE_FIELDS, StateArray


@pytest.fixture
def make_states() -> Callable[..., StateArray]:
    def make(count: int, first: int = 0, start: float = 1.7e9, seed: int = 0) -> StateArray:
        random = np.random.default_rng(seed)
        states = np.zeros(count, STATE_DTYPE)
        states["time"] = start + (first + np.arange(count)) * 1e-3
        states["sequence"] = (first + np.arange(count, dtype=np.int64)) & 0xFFFFFFFF
        for name in STATE_FIELDS:
            states[name] = random.standard_normal(count)
        states["flags"] = random.integers(0, 256, count)
        return states

    return make


class Cable:
    """A pseudo-terminal behind a path that stays the same when it is plugged out and in, as udev's names do."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.box = -1
        self.plug_in()

    def plug_in(self) -> None:
        self.box, other = os.openpty()
        tty.setraw(other)
        self.path.symlink_to(os.ttyname(other))
        os.close(other)
        os.set_blocking(self.box, False)

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        if self.box >= 0:
            os.close(self.box)
        self.box = -1


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "ttyBOX")
    yield made
    made.unplug()
