# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from hydro_sim.model.bench import Bench


@pytest.fixture(scope="session")
def bench() -> Bench:
    """The shipped bench, load-cell amplifier included."""
    return Bench.nominal()


class Memory:
    """A line of bytes without a port: what `BoxLink` needs of a terminal."""

    plugged = opened = True

    def __init__(self) -> None:
        self.down, self.up = b"", b""

    def read(self) -> bytes:
        data, self.down = self.down, b""
        return data

    def write(self, data: bytes) -> int:
        self.up += data
        return len(data)


@pytest.fixture
def memory() -> Memory:
    """A new line of bytes."""
    return Memory()
