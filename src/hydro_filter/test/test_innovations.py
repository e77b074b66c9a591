# SPDX-License-Identifier: Apache-2.0
"""The filter's watch on its own model: told within a second where it does not hold, silent where it does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import CorrectionStatus, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import LoopFilter, default_filter
from hydro_filter.model.sample import Sample
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant
from tests.changing_plant import ChangingPlant, modified_truth
from tests.filtered_run import Run, Trial, run

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
RETURN = 3000
"""HYDRO_RETURN of firmware/hydro/monitor.h."""
CHANGE = 1500
"""Sample of the change; the reference has faded in long before."""
CHANGES: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"bench": {"spring_stiffness": 10e3}}, ("load", "motion")),
    ({"bench": {"spring_stiffness": 28e3}}, ("load", "motion")),
    ({"bench": {"spring_stiffness": 50e3}}, ("load", "motion")),
    ({"bench": {"supply_pressure": 10e6}}, ("chamber a", "chamber b")),
    ({"effects": {"valve_gain": {"ratio": 0.75}}}, ("chamber a", "chamber b")),
    ({"bench": {"piston_area": 2.6e-4}}, ("chamber a", "chamber b", "hydraulic force")),
)


@pytest.fixture(scope="module")
def contraction_filter() -> LoopFilter:
    return default_filter(Bench.nominal())


def played(
    contraction_filter: LoopFilter, plant: Plant, seconds: float, gains: FloatArray | None = None, seed: int = 0
) -> Run:
    chosen = np.tile((250.0, 15.0), (round(100 * seconds), 1)) if gains is None else gains
    return run(Trial(bench=Bench.nominal(), reference=SINE, gains=chosen, seed=seed), plant, contraction_filter)


def mismatches(done: Run) -> FloatArray:
    """Samples that were answered MISMATCH."""
    return np.flatnonzero([result.status is CorrectionStatus.MISMATCH for result in done.results])


def becoming(*changes: Mapping[str, Any], at: tuple[int, ...] = (CHANGE,)) -> ChangingPlant:
    return ChangingPlant([modified_truth({}), *map(modified_truth, changes)], at)


@pytest.mark.parametrize(("change", "names"), CHANGES, ids=str)
def test_a_bench_that_changes_is_told_within_a_second_and_corrected_no_more(
    contraction_filter: LoopFilter, change: dict[str, Any], names: tuple[str, ...]
) -> None:
    """By the equation that no longer holds; from then on no certificate is claimed, and the gains are narrow."""
    done = played(contraction_filter, becoming(change), 2.5)
    first = int(mismatches(done)[0])
    assert CHANGE < first < CHANGE + 1000
    assert any(f"the model's {name} (" in contraction_filter.mismatch for name in names), contraction_filter.mismatch
    assert all(result.status is CorrectionStatus.MISMATCH for result in done.results[first:])
    assert all(result.delta_u == 0.0 and np.isnan(result.before) for result in done.results[first:])
    assert done.states["proportional_gain"][first] == 250.0
    after = done.states[first + 1 :]
    assert (after["proportional_gain"] == 90.0).all() and (after["integral_gain"] == 15.0).all()
    assert ((after["flags"] & Flag.FILTER_STALE) != 0).all()


def test_the_bench_that_was_learned_raises_no_alarm(contraction_filter: LoopFilter) -> None:
    """Under gains drawn every 0.5 s, and every 10 ms."""
    wide, unstable, base = ((-40.0, -5.0), (300.0, 15.0)), ((-40.0, -5.0), (40.0, 5.0)), ((15.0, 5.0), (15.0, 5.0))
    long = [(becoming(at=()), ends, 50, 8.0) for ends in (wide, unstable, base)]
    short = [(becoming(at=()), wide, 1, 6.0), (make_plant(), wide, 50, 6.0)]
    for seed, (plant, ends, hold, lasts) in enumerate(long + short):
        steps = round(100 * lasts)
        gains = np.repeat(np.random.default_rng(seed).uniform(*ends, (-(-steps // hold), 2)), hold, axis=0)[:steps]
        done = played(contraction_filter, plant, lasts, gains, seed)
        assert not len(mismatches(done)) and done.bounded, ends


def test_a_mismatch_stays_until_the_bench_is_the_learned_one_again_for_seconds_of_motion(
    contraction_filter: LoopFilter,
) -> None:
    back = 2500
    done = played(contraction_filter, becoming(CHANGES[1][0], {}, at=(CHANGE, back)), 9.5)
    told = mismatches(done)
    assert (np.diff(told) == 1).all() and told[-1] >= back + RETURN
    assert done.results[-1].status is not CorrectionStatus.MISMATCH
    assert done.states["proportional_gain"][-1] == 250.0


@pytest.mark.parametrize("broken", [False, True])
def test_missing_samples_neither_raise_an_alarm_nor_end_one(contraction_filter: LoopFilter, broken: bool) -> None:
    """Left out: a piece of 30 ms in every 200 ms, which nobody's spool and force would come through."""
    plant = becoming(CHANGES[2][0]) if broken else becoming(at=())
    states = played(contraction_filter, plant, 4.0).states
    contraction_filter.reset()
    for k, record in enumerate(states):
        if k % 200 == 30:
            contraction_filter.reset_history()
        if k % 200 >= 30:
            contraction_filter.correct(Sample.from_record(record))
    assert bool(contraction_filter.mismatch) == broken


def test_a_wrong_sample_is_no_mismatch(contraction_filter: LoopFilter) -> None:
    states = played(contraction_filter, becoming(at=()), 1.0).states
    states["load_force"][500] += 400.0
    states["pressure_a"][600] += 5e6
    contraction_filter.reset()
    for record in states:
        contraction_filter.correct(Sample.from_record(record))
    assert not contraction_filter.mismatch
