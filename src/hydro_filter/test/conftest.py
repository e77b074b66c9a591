# SPDX-License-Identifier: Apache-2.0
"""Shared: the nominal bench, random states within what its sensors can show, and a bench file with its metric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import FloatArray
from hydro_filter.metric import MetricDesign, ScheduledMetric
from hydro_filter.model.loop import make_loop
from hydro_filter.model.sample import STATES
from hydro_filter.precompile import EXAMPLE_EFFECTS
from hydro_sim.box.box import BoxConfig
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


@pytest.fixture(scope="session")
def model(bench: Bench) -> Bench:
    """A bench file of what a diagnosis finds on most benches."""
    return replace(bench, effects=EXAMPLE_EFFECTS)


@pytest.fixture(scope="session")
def metric(bench: Bench, model: Bench) -> ScheduledMetric:
    """Its metric for both laws, solved at rest, without rollouts."""
    loop, c_1 = make_loop(model, bench), BoxConfig().compensated.velocity_compensation
    shaped = MetricDesign(velocity_compensation=c_1, gain_low=15.0, gain_high=400.0)
    paper, other = (ScheduledMetric.from_design(loop, design) for design in (MetricDesign(gain_high=70.0), shaped))
    return replace(paper, another=other)
