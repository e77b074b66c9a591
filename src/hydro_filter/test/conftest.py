# SPDX-License-Identifier: Apache-2.0
"""Shared: the nominal bench, and a bench file with its metric."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hydro_filter.metric import MetricDesign, ScheduledMetric
from hydro_filter.model.loop import make_loop
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench


@pytest.fixture(scope="session")
def bench() -> Bench:
    return Bench.nominal()


@pytest.fixture(scope="session")
def model(bench: Bench) -> Bench:
    """A bench file of what a diagnosis finds on most benches."""
    effects = (
        {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}},
        {"id": "friction_coulomb", "parameters": {"force": 12.0}},
        {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},
    )
    return replace(bench, effects=effects)


@pytest.fixture(scope="session")
def metric(bench: Bench, model: Bench) -> ScheduledMetric:
    """Its metric for both laws, solved at rest, without rollouts."""
    loop, c_1 = make_loop(model, bench), BoxConfig().compensated.velocity_compensation
    shaped = MetricDesign(velocity_compensation=c_1, gain_low=15.0, gain_high=400.0)
    paper, other = (ScheduledMetric.from_design(loop, design) for design in (MetricDesign(gain_high=70.0), shaped))
    return replace(paper, another=other)
