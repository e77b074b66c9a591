# SPDX-License-Identifier: Apache-2.0
"""The compiled filter against the one with OSQP, sample by sample."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from hydro_bridge.signals import PLANT_FIELDS, STATE_DTYPE, CorrectionStatus, FloatArray, StateArray
from hydro_filter.controller.compiled import decide, filter_parts
from hydro_filter.controller.filter import ContractionFilter, FilterSettings
from hydro_filter.model.sample import Sample
from hydro_sim.model.bench import Bench

WITHIN = 1e-6  # A


def records(states: FloatArray, seed: int) -> StateArray:
    """States with gains, errors and currents for every status; the last two have an entry that is not finite."""
    rng = np.random.default_rng(seed)
    made = np.zeros(len(states), STATE_DTYPE)
    for name, column in zip(PLANT_FIELDS, states.T, strict=True):
        made[name] = column
    made["nominal_valve_current"] = rng.uniform(-0.07, 0.07, len(states))
    made["reference_force"] = made["load_force"] + rng.normal(0.0, 150.0, len(states))
    made["proportional_gain"] = rng.uniform(-300.0, 90.0, len(states))
    made["piston_velocity"][-1], made["nominal_valve_current"][-2] = nan, inf
    return made


@pytest.mark.parametrize("rate", [0.1, 2.0])
def test_the_compiled_call_decides_as_the_filter_does(bench: Bench, states: FloatArray, rate: float) -> None:
    at, single = records(states, seed=1), ContractionFilter.for_bench(bench, FilterSettings(contraction_rate=rate))
    parts = filter_parts(single.certificate)
    seen = set()
    for record in at:
        sample = Sample.of(record)
        expected = single.correct(sample)
        delta_u, before, after, status = decide(
            parts, sample.state, sample.nominal_current, sample.reference_force, sample.proportional_gain
        )
        assert status == expected.status
        assert delta_u == pytest.approx(expected.delta_u, abs=WITHIN)
        np.testing.assert_allclose(before, expected.before, rtol=1e-9)
        per_ampere = abs((expected.before - expected.after) / expected.delta_u) if expected.delta_u else 0.0
        np.testing.assert_allclose(after, expected.after, rtol=1e-9, atol=per_ampere * WITHIN)
        seen.add(expected.status)
    decided = {CorrectionStatus.PASS, CorrectionStatus.MODIFIED, CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE}
    assert seen == decided | {CorrectionStatus.NAN}


def test_what_has_no_compiled_form_is_named(bench: Bench) -> None:
    certificate = replace(ContractionFilter.for_bench(bench).certificate, metric=object())
    with pytest.raises(TypeError, match="no compiled form of object, AnalyticDynamics, ForceLaw together"):
        filter_parts(certificate)
