# SPDX-License-Identifier: Apache-2.0
"""Regimes in which the simulation is wrong: chance names few, and what depends on a variable is found by it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.regimes import where, wrong_regimes
from hydro_sim.model.bench import Bench
from tests.segments import problem_in, record


@pytest.fixture(scope="module")
def problem() -> Problem:
    return problem_in(record(Bench.nominal(), seconds=40.0))


def noise(problem: Problem, seed: int) -> np.ndarray:
    """A residual of twice the noise's size that remembers itself for a tenth of a second."""
    random, layout, residual = np.random.default_rng(seed), problem.layout, np.zeros(len(problem.layout.time))
    for channel in np.unique(layout.channel):
        at = layout.channel == channel
        kept = np.exp(-np.diff(layout.time[at][:2]) / 0.1)[0]
        slow = lfilter([1.0], [1.0, -kept], random.normal(size=at.sum()))
        residual[at] = 2.0 * slow / slow.std()
    return residual


def test_chance_names_a_regime_in_few_recordings(problem: Problem) -> None:
    named = [bool(wrong_regimes(problem, noise(problem, seed))) for seed in range(40)]
    assert sum(named) <= 6, "2 expected at a false-discovery rate of 0.05"
    assert not wrong_regimes(problem, 0.4 * noise(problem, 1)), "what is no more than noise is not looked at"


@pytest.mark.parametrize(
    ("variable", "channel"), [("velocity", "motion"), ("position", "load"), ("time", "pressure_a")]
)
def test_what_depends_on_a_variable_is_found_by_it(problem: Problem, variable: str, channel: str) -> None:
    layout, model = problem.layout, problem.models[0]
    at = layout.channel == CHANNELS.index(channel)
    values = np.interp(layout.time[at], model.time, model.variable(variable))
    middle = 0.0 if variable == "velocity" else float(np.median(values))
    residual = noise(problem, 1)
    residual[at] += 2.0 * np.sign(values - middle)
    found = wrong_regimes(problem, residual)
    low, high = found[channel][0], found[channel][-1]
    assert {one.variable for one in found[channel]} == {variable}
    assert low.mean < 0.0 < high.mean and low.high <= middle <= high.low
    assert max(one.rate for one in found[channel]) <= 0.05
    assert variable in where(found[channel], "N") and "N from" in where(found[channel], "N")
