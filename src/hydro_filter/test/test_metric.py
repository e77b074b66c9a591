# SPDX-License-Identifier: Apache-2.0
"""The metric: labels by what rollouts do, its range, what refuses it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.settings import check
from hydro_core.signals import SAMPLE_PERIOD, STATE_DTYPE, FloatArray
from hydro_filter.metric import (
    GAIN_TABLE_STEPS_MAX,
    MetricDesign,
    ScheduledMetric,
    closed_loop_at_rest,
    limit_to_stable_range,
    spectral_radius,
)
from hydro_filter.model.loop import Loop, make_loop, without_overlap
from hydro_filter.training import data
from hydro_filter.training.data import NEITHER, STABLE, UNSTABLE, DataSettings, Rollout
from hydro_filter.training.metric_learning import plant_without_overlap, refine_factor, require_held_out
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.learned_bench import load_model, make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

DATA, DESIGN = DataSettings(rollouts=8, windows=10), MetricDesign()


@pytest.fixture(scope="module")
def loop(bench: Bench) -> Loop:
    return make_loop(load_model(), bench)


@pytest.fixture(scope="module")
def rollouts(bench: Bench) -> list[Rollout]:
    plant = make_plant()
    return [data.roll_out(plant, bench, DATA, index) for index in range(DATA.rollouts)]


@pytest.mark.parametrize(("growth", "label"), [(-2.0, STABLE), (-0.1, NEITHER), (0.5, UNSTABLE)])
def test_twins_say_whether_gains_are_stable(growth: float, label: int) -> None:
    """Two runs of 3 s whose distance grows at a rate [1/s] after the pulse."""
    first, second = np.zeros((2, 3000), STATE_DTYPE)
    second["load_force"][1000:] = 5.0 * np.exp(growth * 1e-3 * np.arange(2000))
    assert data.stability_label(first, second) == label


def test_rollouts_are_labelled_as_the_bench_is(rollouts: list[Rollout]) -> None:
    for rollout in rollouts:
        kp = rollout.gains[0]
        if kp < -5.0 or kp > 140.0:
            assert rollout.label == UNSTABLE
        elif 15.0 < kp < 90.0:
            assert rollout.label == STABLE


def test_descent_makes_one_metric_decay_along_loops_that_differ(loop: Loop) -> None:
    metric = ScheduledMetric.from_design(loop, DESIGN)
    closed = np.array([closed_loop_at_rest(loop, gain) for gain in np.linspace(40.0, 60.0, 40)])
    row, table = int(np.searchsorted(metric.gains, 50.0)), metric.table.copy()
    table[row] = refine_factor(table[row], closed, 0.4)

    def slowest(weight: FloatArray) -> float:
        """Largest lambda [1/s] with F'PF <= exp(-2 lambda T) P for all loops; negative if v'Pv can grow."""
        inverse = np.linalg.inv(np.linalg.cholesky(weight))
        ratios = np.linalg.eigvalsh(inverse @ closed.swapaxes(1, 2) @ weight @ closed @ inverse.T)
        return float(-0.5 * np.log(ratios.max()) / SAMPLE_PERIOD)

    assert slowest(metric.matrix(50.0)) < -2.0
    assert slowest(replace(metric, table=table).matrix(50.0)) > 0.4


def test_a_metric_that_says_itself_that_it_does_not_hold_is_unfit(loop: Loop) -> None:
    metric = ScheduledMetric.from_design(loop, DESIGN)
    assert metric.validity_error("own") == replace(metric, training={"violated": 3.0}).validity_error("own") == ""
    for training in ({"violated": 93.0}, {"violated": 36.1}, {"foreign_violated": 50.0}):
        assert "of the held-out" in replace(metric, training=training).validity_error("own")


def test_a_range_ends_where_the_loop_at_rest_decays_no_more(loop: Loop) -> None:
    asked = replace(DESIGN, gain_high=200.0)
    found = limit_to_stable_range(loop, asked)
    limit = found.gain_high / asked.gain_share
    before, beyond = (spectral_radius(closed_loop_at_rest(loop, gain)) for gain in (limit - 1.0, limit))
    assert before < 1.0 <= beyond, "a reserve below the gain at which the loop decays no more"
    assert limit_to_stable_range(loop, found) == found
    with pytest.raises(ValueError, match="does not decay at K_p = 150 1/s"):
        limit_to_stable_range(loop, replace(asked, gain_low=150.0))
    with pytest.raises(ValueError, match="rollouts decay from 100 1/s on, the loop up to"):
        limit_to_stable_range(loop, replace(asked, gain_low=100.0))


def test_an_overlap_makes_no_gain_stable_and_none_unstable_that_its_loop_is_not(bench: Bench, model: Bench) -> None:
    """It holds twins apart at a small gain, and at a high one still what the loop without it would not."""
    model = replace(model, effects=(*model.effects, {"id": "valve_deadband", "parameters": {"half_width": 5e-4}}))
    plant, free = AnalyticPlant(model), plant_without_overlap(model)
    assert free is not None and plant_without_overlap(without_overlap(model) or model) is None
    for index, between, held, label in ((94, (35.0, 42.0), NEITHER, STABLE), (19, (120.0, 200.0), STABLE, UNSTABLE)):
        alone, asked = (data.roll_out(plant, bench, DataSettings(), index, one) for one in (None, free))
        assert between[0] < alone.gains[0] < between[1]
        assert (alone.label, asked.label) == (held, label)
        np.testing.assert_array_equal(alone.states, asked.states)


def test_the_box_of_the_rollouts_admits_their_gains_and_the_table_that_of_its_law(bench: Bench) -> None:
    """On a soft spring, where the law's gains are six times the nominal ones; told in single precision by a box."""
    soft = replace(bench, spring_stiffness=2500.0)
    own = BoxConfig().of_bench(soft).compensated
    told = replace(own, base_kp=float(np.float32(own.base_kp)), velocity_compensation=0.25, delta_kp_min=-100.0)
    settings = DataSettings.for_law(told, rollouts=8, seconds=2.0)
    check(settings)
    assert settings.velocity_compensation == 0.25 and settings.gain_max == 1.25 * told.base_kp > 2000.0
    for index in (2, 3):
        run = data.roll_out(AnalyticPlant(soft, noise=0.0), soft, settings, index)
        assert run.gains[0] > 0.0 and not np.isclose(run.gains[0], told.base_kp, rtol=0.05)
        np.testing.assert_allclose(run.states["proportional_gain"], run.gains[0], rtol=1e-6)
    design = MetricDesign(velocity_compensation=0.25, gain_low=20.0, gain_high=float(np.ceil(told.base_kp)))
    gains = ScheduledMetric.from_design(make_loop(soft, soft), design).gains
    assert gains[0] == 20.0 and gains[-1] == design.gain_high >= told.base_kp and len(gains) == GAIN_TABLE_STEPS_MAX + 1


def test_a_range_that_no_held_out_rollout_can_judge_is_refused(rollouts: list[Rollout], loop: Loop) -> None:
    drawn = (data.draw_windows(rollout, loop, DATA, index) for index, rollout in enumerate(rollouts))
    windows = data.Windows.concatenate([one for one in drawn if one is not None])
    kept = replace(windows, gain=np.full_like(windows.gain, 60.0), label=np.full_like(windows.label, STABLE))
    require_held_out(kept, replace(DESIGN, gain_low=50.0, gain_high=70.0))
    with pytest.raises(ValueError, match="no held-out rollout has a gain of the certified range, K_p 75 to 77 1/s"):
        require_held_out(kept, replace(DESIGN, gain_low=75.0, gain_high=77.0))
