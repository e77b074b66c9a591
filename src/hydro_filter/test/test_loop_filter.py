# SPDX-License-Identifier: Apache-2.0
"""The filter with the learned metric: the same by every path, decided whatever the sample holds, and in the loop."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hydro_core.signals import CorrectionStatus, ReferenceSignal, StateArray, Waveform
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, default_filter
from hydro_filter.model.sample import Sample
from hydro_filter.validation.runs import Run, Trial, gammas, run, tracking_rmse
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
NOMINAL = Bench.nominal()
SMALL_AREA = NOMINAL.area_ratio * NOMINAL.piston_area
U_MAX = NOMINAL.valve_current_max
MADE = default_filter(NOMINAL)


@pytest.fixture(scope="module")
def plant() -> Plant:
    return make_plant()


def closed(bench: Bench, plant: Plant, gains: tuple[float, float], made: LoopFilter, seconds: float = 3.0) -> Run:
    steps = round(100 * seconds)
    return run(Trial(bench=bench, reference=SINE, gains=np.tile(gains, (steps, 1)), seed=4), plant, made)


@pytest.fixture(scope="module")
def states(bench: Bench, plant: Plant) -> StateArray:
    """A second of a bench whose gains the filter corrects, shape (1000,)."""
    return closed(bench, plant, (250.0, 15.0), default_filter(bench), 1.0).states


def test_the_certificate_holds_afterwards(bench: Bench, states: StateArray) -> None:
    one, corrected = default_filter(bench), 0
    for record in states:
        result = one.correct(Sample.from_record(record))
        assert result.after <= 1e-6
        assert result.status in (CorrectionStatus.PASS, CorrectionStatus.MODIFIED)
        assert (result.before > 0.0) == (result.delta_u != 0.0)
        corrected += result.status is CorrectionStatus.MODIFIED
    assert corrected > 50


def test_what_is_not_finite_gets_no_correction_and_is_forgotten(bench: Bench, states: StateArray) -> None:
    made = default_filter(bench)
    good = Sample.from_record(states[500])
    for field, bad in product(range(8), (np.nan, np.inf)):
        x = good.state.copy()
        x[field] = bad
        assert made.correct(good._replace(state=x)).status is CorrectionStatus.NAN
        assert made.correct(good._replace(state=x)).delta_u == 0.0
        assert np.isfinite(made.correct(good).after)
    assert made.correct(good._replace(reference_rate=np.nan)).status is CorrectionStatus.NAN


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


def test_a_disarmed_bench_and_an_old_state_are_left_alone(bench: Bench, states: StateArray) -> None:
    made, sample = default_filter(bench), Sample.from_record(states[500])
    assert made.correct(sample._replace(armed=False)) == (0.0, 0.0, 0.0, CorrectionStatus.PASS)
    assert made.correct(sample, age=0.006).status is CorrectionStatus.STALE
    bypass = LoopFilter(made.parts, LoopFilterSettings(bypass=True))
    assert bypass.correct(sample).status is CorrectionStatus.BYPASSED
    assert bypass.correct(sample).delta_u == 0.0


def test_gains_that_the_loop_does_not_bear_are_held(bench: Bench, plant: Plant) -> None:
    for gains in ((300.0, 15.0), (-30.0, -3.0)):
        bypass = LoopFilter(default_filter(bench).parts, LoopFilterSettings(bypass=True))
        assert not closed(bench, plant, gains, bypass).bounded
        held = closed(bench, plant, gains, default_filter(bench))
        assert held.bounded
        assert tracking_rmse(held.states[1000:]) < 15.0


@pytest.mark.parametrize("gains", [(90.0, 15.0), (45.0, 10.0), (15.0, 5.0)])
def test_stable_gains_are_left_alone(bench: Bench, plant: Plant, gains: tuple[float, float]) -> None:
    done = closed(bench, plant, gains, default_filter(bench))
    assert done.bounded
    assert 100.0 * gammas(done.results, bench.valve_current_max).correction < 0.005


def test_the_integral_cannot_wind_up_without_end(bench: Bench, plant: Plant) -> None:
    """What it asks for beyond its allowance is a displacement: at no allowance it is taken away altogether."""
    made = default_filter(bench)
    none = LoopFilter(made.parts.copy())
    none.parts["integral_allowance"] = 0.0
    sample = Sample.from_record(closed(bench, plant, (-30.0, 0.0), made, 0.5).states[-1])
    more = 3000.0 / 1.2e7  # A
    wound = sample._replace(nominal_current=sample.nominal_current + more, valve_current=sample.valve_current + more)
    change = [each.correct(wound).delta_u - each.correct(sample).delta_u for each in (made, none)]
    assert abs(change[1]) > abs(change[0])


def test_a_region_of_another_bench_is_not_used_and_that_is_said(tmp_path: Path) -> None:
    shipped = FilterChoice(bench=NOMINAL)
    assert shipped.describe()["region"] == "proved for the paper's law, proved for the compensated law"
    assert shipped.make_region_monitor(MADE) is not None
    for file in shipped.files["metric"].parent.glob("default_metric.*"):
        shutil.copy(file, tmp_path)
    region = tmp_path / "default_metric.region.json"
    region.write_text(region.read_text().replace(NOMINAL.digest, "0" * len(NOMINAL.digest)))
    (tmp_path / "default_metric.compensated.region.json").unlink()
    choice = FilterChoice(bench=NOMINAL, metric=str(tmp_path / "default_metric.safetensors"))
    assert choice.describe()["region"] == "default_metric.region.json is of another model or bench: not used"
    assert choice.make_region_monitor(MADE) is None
