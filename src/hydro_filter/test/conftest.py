# SPDX-License-Identifier: Apache-2.0
"""Shared: the nominal bench and random states within what its sensors can show."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.model.state import STATES
from hydro_sim.model.bench import Bench

LOW = np.array([-800.0, -2e4, -800.0, -2e4, 1e6, 1e6, 0.005, -0.4])
HIGH = np.array([800.0, 2e4, 800.0, 2e4, 15e6, 15e6, 0.075, 0.4])


@pytest.fixture(scope="session")
def bench() -> Bench:
    return Bench.nominal()


@pytest.fixture(scope="session")
def states() -> FloatArray:
    """200 states, shape (200, 8), SI units."""
    return LOW + (HIGH - LOW) * np.random.default_rng(7).random((200, STATES))
