# SPDX-License-Identifier: Apache-2.0
"""A similar bench, 5 times the force, 0.3 times the pressure, 4 times the stroke: the same to policy and verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.safety.guard_settings import GuardSettings
from hydro_core.bench_scales import rescale
from hydro_core.signals import Command, CorrectionStatus, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import loop_filter
from hydro_filter.metric import MetricDesign, ScheduledMetric
from hydro_filter.model.loop import make_loop
from hydro_policy.compensation.estimator import Compensator, CompensatorSettings
from hydro_policy.compensation.residual import Network, Residual
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp.events import Randomisation
from hydro_sim.box.box import Box, BoxConfig
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
    assert here.sac.updates > 100
    np.testing.assert_allclose(there.sac.actor_parameters(), here.sac.actor_parameters(), rtol=0.0, atol=1e-6)
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


def flags(bench: Bench) -> list[int]:
    """Of a box under load forces about the limit, disarmed at first and in between."""
    told, box = [], Box(bench, BoxConfig().of_bench(bench))
    for number, force in enumerate((0.0, 2.0, 2.34, 2.4, 2.4, 2.45, 2.46, 2.47)):
        measurement = AnalyticPlant(bench, noise=0.0).reset(0)
        measurement[2] = force * bench.size.force
        box.receive(Command(arm=number not in (0, 3)), 1e-3 * number)
        told.append(int(box.tick(measurement, 1e-3 * number)["flags"]))
    return told


def test_the_box_of_a_similar_bench_trips_and_recovers_alike() -> None:
    """Beyond the limit, after the second arming within what the box grants, then beyond that."""
    assert flags(ONE) == flags(OTHER)
    assert [bool(each & Flag.TRIPPED) for each in flags(ONE)] == [False, False, True, False, False, False, False, True]


def tracked(bench: Bench) -> FloatArray:
    """Load forces over the bench's, under the compensated law with its learned residual, shape (8000,)."""
    size, box = bench.size, BoxConfig().of_bench(bench)
    settings = EvaluationSettings(frequencies=(1.0,), measure=6.0, amplitude=size.force)
    fleet = VectorBench([bench], [AnalyticPlant(bench, settings=Sensors.of_size(size))], box)
    estimator = Compensator(settings=rescale(CompensatorSettings(), NOMINAL, size), law=box.compensated)
    residual = Residual(1, Network.load(), estimator.settings.force_scale)
    steps = vector_runs.run(fleet, settings.cases, lambda _: np.zeros((1, 2)), settings, 7, estimator, residual)
    return np.concatenate([step.samples["load_force"][0].copy() for step in steps]) / size.force


def test_the_compensated_law_and_its_residual_track_alike() -> None:
    here, there = map(tracked, WITH_EFFECTS)
    assert np.abs(here).max() > 0.9
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-9)


def test_the_metric_of_a_similar_bench_is_the_same_table() -> None:
    loops = (make_loop(bench, bench) for bench in WITH_EFFECTS)
    here, there = (ScheduledMetric.from_design(loop, MetricDesign()).table for loop in loops)
    np.testing.assert_allclose(there, here, rtol=1e-6, atol=1e-6 * float(np.abs(here).max()))
