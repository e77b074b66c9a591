# SPDX-License-Identifier: Apache-2.0
"""The shipped model predicts the emulated bench, stays bounded, says when it extrapolates; files say what they are."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import ReferenceSignal, Waveform, matrix
from hydro_sim.emulator.offline import Segment, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import weights
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import WeightsError
from hydro_sim.identification import evaluation
from hydro_sim.identification.analytic import AnalyticModel
from hydro_sim.identification.evaluation import Scales, Scored
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


@pytest.fixture(scope="module")
def shipped():
    return Learned.load()


@pytest.fixture(scope="module")
def held_out():
    """A recording that no training has seen, with its noise-free log."""
    recording = record_offline(profile("default"), draw(12.0, 977), seed=977)
    run = Run(name="held out", x=matrix(recording.states), u=recording.states["valve_current"].copy())
    return Scored(run=run, truth=matrix(recording.noise_free))


def test_predictions_reach_the_papers_level(shipped, held_out):
    states = [shipped.model.estimate(held_out.run)]
    how = {"recorded": False, "horizon": 70, "stride": 41}
    clean = evaluation.prediction_errors(shipped.model, states, [held_out], **how)
    analytic = evaluation.prediction_errors(AnalyticModel(Bench.nominal()), states, [held_out], **how)
    share = clean.rmse / Scales.of(held_out.truth).span
    for column, level in {0: 0.0006, 2: 0.0009, 4: 0.0004, 5: 0.0002, 6: 0.0031}.items():
        assert share[column] <= level
    assert np.all(clean.rmse < 0.05 * analytic.rmse)


def test_estimates_look_only_back(shipped, held_out):
    whole = shipped.model.estimate(held_out.run)
    part = shipped.model.estimate(held_out.run.part(0, 2500))
    assert np.array_equal(whole[:2500], part)


def test_closed_loop_errs_as_the_emulator(shipped):
    bench, plant = Bench.nominal(), LearnedPlant(shipped)
    mine = simulate(plant, bench, Schedule(reference=SINE, gains=(60.0, 15.0), seconds=4.0), seed=1)
    truth = record_offline(profile("default"), [Segment.of(SINE, 4.0, 60.0, 15.0)], seed=2).states
    rmse = [np.sqrt(np.mean((run["reference_force"] - run["load_force"])[2000:] ** 2)) for run in (mine, truth)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.05)


def test_plant_stays_bounded_under_any_current(shipped):
    plant = LearnedPlant(shipped)
    plant.reset(3)
    rng = np.random.default_rng(4)
    for _ in range(60):
        current = float(rng.choice([-0.05, 0.05, rng.uniform(-0.05, 0.05)]))
        for _ in range(100):
            x = plant.step(current)
            assert np.all(np.isfinite(x))
    assert np.all(np.abs(x) < [1e5, 1e8, 1e5, 1e8, 1e8, 1e8, 1.0, 100.0])


def test_plant_says_when_it_extrapolates(shipped):
    plant, bench = LearnedPlant(shipped), Bench.nominal()
    simulate(plant, bench, Schedule(reference=SINE, gains=(60.0, 10.0), seconds=1.0))
    assert not plant.extrapolating
    plant.reset(0)
    for _ in range(200):
        plant.step(0.05)
    assert plant.extrapolating
    plant.reset(0)
    assert not plant.extrapolating


def test_save_load(shipped, tmp_path):
    learned = shipped
    learned.save(tmp_path / "w.safetensors")
    again = Learned.load(tmp_path / "w.safetensors")
    assert again.training == learned.training
    one, other = LearnedPlant(learned), LearnedPlant(again)
    for k in range(50):
        assert np.array_equal(one.step(1e-3 * np.sin(k)), other.step(1e-3 * np.sin(k)))


def broken_files(folder, shipped):
    """Files that are no weights, and a part of the sentence that says why."""
    tensors, header = shipped.model.tensors(), shipped.model.header()
    (folder / "text").write_text("no weights")
    yield folder / "missing", "no such file"
    yield folder / "text", "cannot be read"
    weights.save(folder / "structure", tensors, {**header, "structure": "magic"})
    yield folder / "structure", "magic"
    weights.save(folder / "parts", {"theta": tensors["theta"]}, header)
    yield folder / "parts", "does not fit its header"
    weights.save(folder / "hidden", tensors, {**header, "hidden": [3, 3]})
    yield folder / "hidden", "does not fit its header"
    weights.save(folder / "format", tensors, {**header, "format": 99})
    yield folder / "format", "format 99"


def test_wrong_files_are_refused_in_a_sentence(shipped, tmp_path):
    for path, reason in broken_files(tmp_path, shipped):
        with pytest.raises(WeightsError, match=reason) as caught:
            Learned.load(path)
        assert "\n" not in str(caught.value)
