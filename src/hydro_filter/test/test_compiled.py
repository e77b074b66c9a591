# SPDX-License-Identifier: Apache-2.0
"""The compiled filter against the one with OSQP, sample by sample and bench by bench."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from hydro_bridge.signals import PLANT_FIELDS, STATE_DTYPE, CorrectionStatus, FloatArray, StateArray
from hydro_filter.certificate import Certificate
from hydro_filter.compiled import FilterBank, filter_parts
from hydro_filter.filter import ContractionFilter
from hydro_filter.metric import ConstantMetric
from hydro_filter.model_dynamics import model_dynamics
from hydro_filter.sample import Sample
from hydro_sim.bench import Bench
from hydro_sim.learned.model import Learned

WITHIN = 1e-6  # A


def records(states: FloatArray, seed: int) -> StateArray:
    """States with gains, errors and currents for every status; the last two have an entry that is not finite."""
    rng = np.random.default_rng(seed)
    made = np.zeros(len(states), STATE_DTYPE)
    for name, column in zip(PLANT_FIELDS, states.T, strict=True):
        made[name] = column
    made["nominal_valve_current"] = rng.uniform(-0.07, 0.07, len(states))
    made["valve_current"] = np.clip(made["nominal_valve_current"], -0.05, 0.05)
    made["reference_force"] = made["load_force"] + rng.normal(0.0, 150.0, len(states))
    made["proportional_gain"] = rng.uniform(-300.0, 90.0, len(states))
    made["piston_velocity"][-1], made["nominal_valve_current"][-2] = nan, inf
    return made


@pytest.fixture(params=["analytic", "learned"])
def source(bench: Bench, request: pytest.FixtureRequest) -> Certificate:
    certificate = ContractionFilter.for_bench(bench).certificate
    if request.param == "analytic":
        return certificate
    root = np.random.default_rng(2).normal(size=(8, 8))
    return replace(
        certificate, dynamics=model_dynamics(Learned.load().model), metric=ConstantMetric(root @ root.T + np.eye(8))
    )


def test_a_bank_decides_as_the_filter_does(source: Certificate, states: FloatArray) -> None:
    at = records(states, seed=1)
    decisions, single = FilterBank(source, len(at)).correct(at), ContractionFilter(source)
    seen = set()
    for k, record in enumerate(at):
        expected = single.correct(Sample.of(record))
        assert decisions.status[k] == expected.status
        assert decisions.delta_u[k] == pytest.approx(expected.delta_u, abs=WITHIN)
        np.testing.assert_allclose(decisions.before[k], expected.before, rtol=1e-9)
        per_ampere = abs((expected.before - expected.after) / expected.delta_u) if expected.delta_u else 0.0
        np.testing.assert_allclose(decisions.after[k], expected.after, rtol=1e-9, atol=per_ampere * WITHIN)
        seen.add(expected.status)
    assert seen >= {CorrectionStatus.PASS, CorrectionStatus.MODIFIED, CorrectionStatus.NAN}


def test_a_bank_follows_every_bench_by_itself(bench: Bench, states: FloatArray) -> None:
    """Hidden states after some samples are those of one model that saw the same; a forgotten bench begins anew."""
    certificate = replace(ContractionFilter.for_bench(bench).certificate, dynamics=model_dynamics(Learned.load().model))
    bank, single = FilterBank(certificate, 2), model_dynamics(Learned.load().model)
    for k in range(20):
        at = records(states[:198][[k, k + 1, 0, 0]], seed=k)[:2]
        bank.correct(at)
        single.observe(Sample.of(at[0]).state, float(at["valve_current"][0]))
    np.testing.assert_allclose(bank.hidden[0], single.hidden, rtol=1e-12)
    bank.forget(np.array([True, False]))
    assert np.isnan(bank.hidden[0]).all()
    assert np.isfinite(bank.hidden[1]).all()


def test_what_has_no_compiled_form_is_named(bench: Bench) -> None:
    certificate = replace(ContractionFilter.for_bench(bench).certificate, metric=object())
    with pytest.raises(TypeError, match="no compiled form of object"):
        filter_parts(certificate)
