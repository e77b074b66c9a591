# SPDX-License-Identifier: Apache-2.0
"""The shipped learned bench predicts the emulated bench and stays bounded."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import ReferenceSignal, Waveform, matrix
from hydro_sim.emulator.offline import Segment, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import draw
from hydro_sim.files.learned_bench import load_model, make_plant
from hydro_sim.files.recordings import Run
from hydro_sim.identification import validate
from hydro_sim.identification.validate import AnalyticModel, BenchPrediction, Scored
from hydro_sim.model.bench import Bench
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


@pytest.fixture(scope="module")
def held_out():
    """A recording that no training has seen, with its noise-free log."""
    recording = record_offline(profile("default"), draw(12.0, 977), seed=977)
    run = Run(name="held out", x=matrix(recording.states), u=recording.states["valve_current"].copy())
    return Scored(run=run, truth=matrix(recording.noise_free))


@pytest.fixture(scope="module")
def shipped(held_out):
    return BenchPrediction(load_model(), [held_out.run])


def test_predictions_reach_the_papers_level(shipped, held_out):
    states, analytic_bench = [shipped.estimate(held_out.run)], AnalyticModel(Bench.nominal())
    how = {"recorded": False, "horizon": 70, "stride": 41}
    clean = validate.prediction_errors(shipped, states, [held_out], **how)
    analytic = validate.prediction_errors(analytic_bench, [analytic_bench.estimate(held_out.run)], [held_out], **how)
    share = clean.rmse / np.ptp(held_out.truth, axis=0)
    for column, level in {0: 0.0006, 2: 0.0009, 4: 0.0004, 5: 0.0002, 6: 0.0031}.items():
        assert share[column] <= level
    readings = [0, 2, 4, 5, 6]  # the box's rates begin with the measured ones, noise and all
    assert np.all(clean.rmse[readings] < 0.05 * analytic.rmse[readings])


def test_estimates_look_only_back(shipped, held_out):
    whole = shipped.estimate(held_out.run)
    part = shipped.estimate(held_out.run.part(0, 2500))
    assert np.array_equal(whole[:2500], part)


def test_closed_loop_errs_as_the_emulator():
    bench, plant = Bench.nominal(), make_plant()
    mine = simulate(plant, bench, Schedule(reference=SINE, gains=(60.0, 15.0), seconds=4.0), seed=1)
    truth = record_offline(
        profile("default"), [Segment(seconds=4.0, waveform="sine", amplitude=300.0, kp=60.0)], seed=2
    ).states
    rmse = [np.sqrt(np.mean((run["reference_force"] - run["load_force"])[2000:] ** 2)) for run in (mine, truth)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.05)


def test_plant_stays_bounded_under_any_current():
    plant = make_plant()
    plant.reset(3)
    rng = np.random.default_rng(4)
    for _ in range(60):
        current = float(rng.choice([-0.05, 0.05, rng.uniform(-0.05, 0.05)]))
        for _ in range(100):
            x = plant.step(current)
            assert np.all(np.isfinite(x))
    assert np.all(np.abs(x) < [1e5, 1e8, 1e5, 1e8, 1e8, 1e8, 1.0, 100.0])
