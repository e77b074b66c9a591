# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import pytest

from hydro_sim.model.bench import Bench


@pytest.fixture(scope="session")
def bench() -> Bench:
    """The shipped bench, load-cell amplifier included."""
    return Bench.nominal()


@pytest.fixture(scope="session")
def ideal(bench: Bench) -> Bench:
    """The same with an ideal load cell."""
    return replace(bench, load_cell_bandwidth=None)
