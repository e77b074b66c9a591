# SPDX-License-Identifier: Apache-2.0
"""The filter under the paper's law: decided whatever the sample holds, in the loop, and across a valve's overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hydro_core.signals import CorrectionStatus, ReferenceSignal, StateArray, Waveform
from hydro_core.valve_overlap import valve_overlap
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, default_filter, filter_record
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import without_overlap
from hydro_filter.model.sample import Sample
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant
from tests.filtered_run import Run, Trial, run

NOMINAL = Bench.nominal()
SMALL_AREA = NOMINAL.area_ratio * NOMINAL.piston_area
U_MAX = NOMINAL.valve_current_max
MADE = default_filter(NOMINAL)
PLANT = make_plant()


def closed(
    made: LoopFilter, gains: tuple[float, float], plant: Plant = PLANT, seconds: float = 3.0, amplitude: float = 200.0
) -> Run:
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=1.0)
    return run(Trial(bench=NOMINAL, reference=reference, gains=np.tile(gains, (round(100 * seconds), 1)), seed=4),
               plant, made)  # fmt: skip


def tracking_rmse(states: StateArray) -> float:
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"]) ** 2)))


@pytest.fixture
def made() -> LoopFilter:
    """The shipped filter, as it begins."""
    MADE.reset()
    return MADE


@pytest.fixture(scope="module")
def states() -> StateArray:
    """A second of a bench whose gains the filter corrects, shape (1000,)."""
    return closed(MADE, (250.0, 15.0), seconds=1.0).states


def test_the_certificate_holds_afterwards(made: LoopFilter, states: StateArray) -> None:
    results = [made.correct(Sample.from_record(record)) for record in states]
    assert {result.status for result in results} == {CorrectionStatus.PASS, CorrectionStatus.MODIFIED}
    assert all(result.after <= 1e-6 and (result.before > 0.0) == (result.delta_u != 0.0) for result in results)
    assert sum(result.status is CorrectionStatus.MODIFIED for result in results) > 50


def test_what_is_not_finite_gets_no_correction_and_is_forgotten(made: LoopFilter, states: StateArray) -> None:
    good = Sample.from_record(states[500])
    for field, bad in product(range(8), (np.nan, np.inf)):
        x = good.state.copy()
        x[field] = bad
        result = made.correct(good._replace(state=x))
        assert (result.status, result.delta_u) == (CorrectionStatus.NAN, 0.0)
        assert np.isfinite(made.correct(good).after)
    assert made.correct(good._replace(reference_rate=np.nan)).status is CorrectionStatus.NAN


OSQP = LoopFilterSettings(solver="osqp")


def test_osqp_corrects_as_the_closed_form_does(made: LoopFilter, states: StateArray) -> None:
    """On samples of a run, and of one whose gains are unstable at either side, to 1e-6 of the valve's current."""
    other, records = LoopFilter(made.record, OSQP), [*states, *closed(made, (-40.0, -5.0), seconds=0.5).states]
    made.reset()
    for record in records:
        sample = Sample.from_record(record)
        here, there = made.correct(sample), other.correct(sample)
        assert there[1:] == here[1:] and abs(there.delta_u - here.delta_u) <= 1e-6 * U_MAX
    assert here.status is CorrectionStatus.MODIFIED


@pytest.mark.parametrize("answer", [np.nan, np.inf])
def test_a_program_that_osqp_does_not_solve_gets_the_answer_of_a_filter_that_is_not_finite(
    made: LoopFilter, states: StateArray, answer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, corrected = LoopFilter(made.record, OSQP), 0
    monkeypatch.setattr(other.solver, "solve", lambda *program: answer)
    for sample in map(Sample.from_record, states):
        here, there = made.correct(sample), other.correct(sample)
        if here.status is CorrectionStatus.MODIFIED:
            corrected += 1
            assert (there.delta_u, there.status) == (0.0, CorrectionStatus.NAN) and np.isnan(there.after)
        else:
            assert there == here
    assert corrected > 50


@given(
    values=st.lists(st.floats(width=64), min_size=8, max_size=8),
    others=st.lists(st.floats(width=64), min_size=5, max_size=5),
)
@example(values=[0.0] * 6 + [-NOMINAL.dead_volume_a / NOMINAL.piston_area, 0.0], others=[0.0] * 5)
@example(values=[0.0] * 6 + [NOMINAL.stroke + NOMINAL.dead_volume_b / SMALL_AREA, 0.0], others=[0.0] * 5)
@settings(max_examples=300, deadline=None)
def test_it_never_raises_and_never_leaves_the_valve(values: list[float], others: list[float]) -> None:
    """Also where a chamber has no volume, by which the equations divide."""
    sample = Sample(np.array(values), *others)
    result = MADE.correct(sample)
    assert np.isfinite(result.delta_u)
    if result.delta_u != 0.0:
        assert abs(sample.nominal_current + result.delta_u) <= U_MAX + 1e-9 * abs(sample.nominal_current)


def test_a_disarmed_bench_and_an_old_state_are_left_alone(made: LoopFilter, states: StateArray) -> None:
    sample, bypass = Sample.from_record(states[500]), LoopFilter(made.record, LoopFilterSettings(bypass=True))
    assert made.correct(sample._replace(armed=False)) == (0.0, 0.0, 0.0, CorrectionStatus.PASS)
    assert made.correct(sample, age=0.006).status is CorrectionStatus.STALE
    assert bypass.correct(sample)[::3] == (0.0, CorrectionStatus.BYPASSED)


@pytest.mark.parametrize("gains", [(300.0, 15.0), (-30.0, -3.0)])
def test_gains_that_the_loop_does_not_bear_are_held(gains: tuple[float, float]) -> None:
    assert not closed(LoopFilter(MADE.record, LoopFilterSettings(bypass=True)), gains).bounded
    held = closed(MADE, gains)
    assert held.bounded and tracking_rmse(held.states[1000:]) < 15.0


@pytest.mark.parametrize("gains", [(90.0, 15.0), (45.0, 10.0), (15.0, 5.0)])
def test_stable_gains_are_left_alone(gains: tuple[float, float]) -> None:
    done = closed(MADE, gains)
    assert done.bounded and np.mean([abs(result.delta_u) for result in done.results]) < 5e-5 * U_MAX


def test_the_integral_cannot_wind_up_without_end() -> None:
    """What it asks for beyond its allowance is a displacement: at no allowance it is taken away altogether."""
    made, none = default_filter(NOMINAL), LoopFilter(MADE.record.copy())
    none.record["integral_allowance"] = 0.0
    sample = Sample.from_record(closed(made, (-30.0, 0.0), seconds=0.5).states[-1])
    more = 3000.0 / 1.2e7  # A
    wound = sample._replace(nominal_current=sample.nominal_current + more, valve_current=sample.valve_current + more)
    change = [one.correct(wound).delta_u - one.correct(sample).delta_u for one in (made, none)]
    assert abs(change[1]) > abs(change[0])


WIDTH = 5e-4


def overlapped(model: Bench, width: float = WIDTH) -> Bench:
    overlap = {"id": "valve_deadband", "parameters": {"half_width": width}}
    return replace(model, effects=(*model.effects, overlap))


@pytest.fixture(scope="module")
def across(model: Bench) -> LoopFilter:
    """A filter of a bench file with an overlap."""
    return LoopFilter(filter_record(ScheduledMetric.load(), overlapped(model), NOMINAL))


def test_the_overlap_is_the_bench_files(model: Bench) -> None:
    shift = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    sizes = {"half_width": 4e-4, "half_width_negative": 2e-4}
    lopsided = replace(NOMINAL, effects=(shift, {"id": "valve_deadband", "form": "lopsided", "parameters": sizes}))
    assert valve_overlap(model.effects) == {"closing": 0.0, "back": 0.0, "out": 0.0} and without_overlap(model) is None
    assert valve_overlap(overlapped(model).effects) == {"closing": 0.0, "back": WIDTH, "out": WIDTH}
    assert valve_overlap(lopsided.effects) == {"closing": -1e-3, "back": 2e-4, "out": 4e-4}
    assert without_overlap(overlapped(model)) == model


def test_corrections_leap_across_the_overlap(model: Bench, across: LoopFilter) -> None:
    """That they are the smallest is `firmware/test/test_filter.c`'s."""
    done = closed(across, (250.0, 15.0), AnalyticPlant(overlapped(model)), amplitude=300.0)
    modified = [result for result in done.results if result.status is CorrectionStatus.MODIFIED]
    assert max(result.after for result in modified) <= 1e-6
    assert sum(abs(result.delta_u) > WIDTH for result in modified) > 10


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_a_filter_that_counts_with_the_overlap_follows_closer_than_one_that_takes_it_for_a_disturbance(
    model: Bench, across: LoopFilter, share: float
) -> None:
    """Also where the bench's overlap is a fifth narrower or wider than the file's."""
    plant, blind = AnalyticPlant(overlapped(model, share * WIDTH)), LoopFilter(across.record.copy())
    blind.record["back"] = blind.record["out"] = 0.0
    runs = [closed(one, (250.0, 15.0), plant, amplitude=300.0) for one in (across, blind)]
    assert all(one.bounded for one in runs)
    counted, ignored = (tracking_rmse(one.states[1000:]) for one in runs)
    assert counted < 0.5 * ignored
