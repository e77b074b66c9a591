# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from hydro_sim.model.bench import Bench


@pytest.fixture(scope="session")
def bench() -> Bench:
    """The shipped bench, load-cell amplifier included."""
    return Bench.nominal()
