# SPDX-License-Identifier: Apache-2.0
"""A similar bench, 5 times the force, 0.3 times the pressure, 4 times the stroke: the same to policy and verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.safety.guard_settings import GuardSettings
from hydro_core.bench_scales import rescale
from hydro_core.signals import CorrectionStatus, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_policy.compensation.estimator import CompensatorSettings
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.task.mdp.events import Randomisation
from hydro_sim.box.box import BoxConfig
from hydro_sim.excitation import ExcitationRange
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from tests.filtered_run import Trial, run

FORCE, PRESSURE, LENGTH, CURRENT = 5.0, 0.3, 4.0, 1.5
AREA, STIFFNESS = FORCE / PRESSURE, FORCE / LENGTH
BY_UNIT = {
    "Pa": PRESSURE, "m2": AREA, "m": LENGTH, "m3": AREA * LENGTH, "m3/s": AREA * LENGTH, "A": CURRENT, "kg": STIFFNESS,
    "N s/m": STIFFNESS, "N/m": STIFFNESS, "-": 1.0, "Hz": 1.0,
}  # fmt: skip


def with_effects(bench: Bench, force: float = 1.0, pressure: float = 1.0, length: float = 1.0) -> Bench:
    """The bench with a lagging valve, friction and a leak, as large as these scales say."""
    effects = {
        "valve_lag": {"bandwidth": 110.0, "damping": 1.2},
        "friction_coulomb": {"force": 12.0 * force},
        "friction_stribeck": {"breakaway_force": 5.0 * force, "velocity": 0.01 * length},
        "friction_presliding": {"stiffness": 5e5 * force / length},
        "leakage_internal": {"coefficient": 1e-13 * force * length / pressure**2},
    }
    return replace(bench, effects=tuple({"id": name, "parameters": values} for name, values in effects.items()))


ONE = Bench.nominal()
OTHER = replace(ONE, **{name: getattr(ONE, name) * BY_UNIT[each.unit] for name, each in Bench.quantities().items()})
WITH_EFFECTS = with_effects(ONE), with_effects(OTHER, FORCE, PRESSURE, LENGTH)


def test_the_size_of_the_similar_bench() -> None:
    one, other = ONE.size, OTHER.size
    assert one == NOMINAL
    ratios = [getattr(other, name) / getattr(one, name) for name in ("force", "pressure", "length", "current")]
    assert ratios == pytest.approx((FORCE, PRESSURE, LENGTH, CURRENT), rel=1e-15)
    for each in (TrainingSettings(), Randomisation(), CompensatorSettings(), Sensors()):
        assert rescale(each, one, one) == each
    limits = rescale(TrainingSettings(), one, other).monitor
    assert (limits.peak_error, limits.chatter) == pytest.approx((FORCE * one.force, CURRENT * 14.0 * one.current))
    assert BoxConfig().of_bench(ONE) == BoxConfig() and GuardSettings.of_size(one) == GuardSettings()
    assert ExcitationRange.of_force(one.force) == ExcitationRange()


def test_learning_curves_are_those_of_the_nominal_bench(pretraining: PretrainSettings) -> None:
    """Of a short pretraining on drawn benches of either size."""
    usual = replace(pretraining, randomisation=Randomisation(), examined=1)
    here, there = (Pretraining(rescale(usual, NOMINAL, bench.size), bench, bench) for bench in (ONE, OTHER))
    for each in (here, there):
        while not each.finished:
            each.run_round()
    assert here.learner.sac.updates > 100
    np.testing.assert_allclose(
        there.learner.sac.actor_parameters(), here.learner.sac.actor_parameters(), rtol=0.0, atol=1e-6
    )
    for one, other in zip(here.history, there.history, strict=True):
        for name, scale in (("return", 1.0), ("score", 1.0), ("changed", 1.0), ("rmse", FORCE)):
            assert np.array(other[name]) / scale == pytest.approx(one[name], rel=1e-9), name


def corrected(bench: Bench, gains: tuple[float, float]) -> tuple[FloatArray, list[CorrectionStatus]]:
    """Corrections over the valve's limit, and their statuses, of the shipped metric's table on this bench."""
    size = bench.size
    sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=size.force, frequency=1.0)
    trial = Trial(bench=bench, reference=sine, gains=np.tile(gains, (100, 1)), box=BoxConfig().of_bench(bench))
    metric = replace(ScheduledMetric.load(), another=None)
    done = run(trial, AnalyticPlant(bench, settings=Sensors.of_size(size)), loop_filter(metric, bench, bench))
    return np.array([result.delta_u for result in done.results]) / size.current, [one.status for one in done.results]


def test_the_filter_corrects_a_similar_bench_alike() -> None:
    """Up to the tolerance of its solver."""
    for gains in ((90.0, 15.0), (-30.0, -3.0)):
        (here, told), (there, also_told) = (corrected(bench, gains) for bench in WITH_EFFECTS)
        np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-8)
        assert also_told == told and CorrectionStatus.MISMATCH not in told
    assert np.abs(here).max() > 1e-3 and CorrectionStatus.MODIFIED in told
