# SPDX-License-Identifier: Apache-2.0
"""The peers of the diagnosis are set up fairly: true equations, true terms, the diagnosis' own held-out error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.peers import terms
from benchmarks.peers.run import Corrected, held_out, signals
from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, Waveform
from hydro_diagnosis.estimation.problem import sensor_noise
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
pytestmark = pytest.mark.study


def recorded(truth: Bench) -> SegmentModel:
    reference = ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=260.0, frequency=0.7)
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=8.0)
    states = simulate(AnalyticPlant(truth), BENCH, schedule, seed=3)
    table = RawTable("run", states["time"].copy(), None, {name: states[name].copy() for name in STATE_FIELDS})
    return SegmentModel(checked(table, BENCH).segments[0], BENCH)


@pytest.fixture(scope="module")
def nominal() -> SegmentModel:
    return recorded(BENCH)


@pytest.mark.parametrize(("key", "term", "ratio"), [("bulk_modulus", "bulk_modulus", 1.1),
                                                    ("valve_nominal_flow", "valve_gain", 0.93)])  # fmt: skip
def test_terms_hold_the_truth_exactly(nominal: SegmentModel, key: str, term: str, ratio: float) -> None:
    along = signals(nominal)
    wrong = terms.nominal(along, replace(BENCH, **{key: ratio * getattr(BENCH, key)}))
    right = terms.nominal(along, BENCH)
    for chamber in "ab":
        change = (ratio - 1.0) * terms.pressure_terms(along, BENCH, chamber)[term]
        np.testing.assert_allclose(
            wrong[f"pressure_{chamber}"] - right[f"pressure_{chamber}"], change, rtol=1e-9, atol=1.0
        )


def test_no_correction_leaves_the_diagnosis_own_held_out_error(nominal: SegmentModel) -> None:
    noise = sensor_noise([nominal])
    plain = held_out([Plant.of(nominal, ())], noise)
    nothing = held_out([Corrected.by(nominal, lambda signal: {})], noise)
    leaking = held_out([Corrected.by(nominal, lambda signal: {"pressure_a": 0.0 * signal["pressure_a"] - 1e8})], noise)
    assert plain == pytest.approx(nothing, rel=1e-10)  # compiled, and in steps: another order of operations
    assert 0.9 < plain < 1.1
    assert leaking > 2.0 * plain
