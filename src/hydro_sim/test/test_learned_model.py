# SPDX-License-Identifier: Apache-2.0
"""The shipped model predicts the emulated bench, stays bounded, says when it extrapolates; files say what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import Flag, ReferenceSignal, Waveform, matrix
from hydro_sim.emulator.offline import Segment, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import weights
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import WeightsError
from hydro_sim.identification import evaluation, validate
from hydro_sim.identification.analytic import AnalyticModel
from hydro_sim.identification.evaluation import Scales, Scored
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.learned.region import Region
from hydro_sim.model.bench import Bench
from hydro_sim.neural import mlp
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


def test_predictions_stay_near_the_noise_floor(shipped, held_out):
    states = [shipped.model.estimate(held_out.run)]
    noisy = evaluation.prediction_errors(shipped.model, states, [held_out], recorded=True, horizon=70, stride=41)
    assert np.all(noisy.rmse <= 1.2 * evaluation.noise_floor([held_out]))


def test_estimates_are_far_better_than_the_measurement(shipped, held_out):
    estimated, settled = shipped.model.estimate(held_out.run), slice(evaluation.SETTLED, None)
    errors = (estimated[:, [0, 1]] - held_out.truth[:, [4, 5]])[settled].std(axis=0)
    assert np.all(errors < 0.3 * 6e3)


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


def test_region_holds_its_samples_and_not_what_lies_beyond():
    rng = np.random.default_rng(0)
    x, u = rng.standard_normal((500, 8)) * [1, 1, 200, 1000, 1e6, 1e6, 1, 1], 1e-3 * rng.standard_normal(500)
    region = Region.about(x, u)
    assert region.distance(x, u).max() < 1.0
    assert region.distance(3.0 * x, 3.0 * u).max() > 1.0


def test_plant_repeats_itself_by_seed(shipped):
    plant = LearnedPlant(shipped)
    runs = []
    for seed in (5, 5, 6):
        plant.reset(seed)
        runs.append(np.array([plant.step(1e-3 * np.sin(0.02 * k)) for k in range(200)]))
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_plants_noise_is_that_of_the_sensors(shipped):
    noisy, clean = LearnedPlant(shipped), LearnedPlant(shipped, noise=0.0)
    noisy.reset(1), clean.reset(1)
    difference = np.array([noisy.step(0.0) - clean.step(0.0) for _ in range(4000)])
    assert difference[:, [0, 2, 4, 5]].std(axis=0) == pytest.approx([0.6, 0.6, 6e3, 6e3], rel=0.05)


def test_still_bench_only_creeps(shipped):
    plant = LearnedPlant(shipped, noise=0.0)
    x = plant.reset(0)
    for _ in range(500):
        moved = plant.step(0.0)
    assert abs(moved[2] - x[2]) < 40.0  # the seal leaks, and the spring gives way to it
    assert abs(moved[7]) < 5e-3


def test_save_load(shipped, tmp_path):
    learned = shipped
    learned.save(tmp_path / "w.safetensors")
    again = Learned.load(tmp_path / "w.safetensors")
    assert again.training == learned.training
    one, other = LearnedPlant(learned), LearnedPlant(again)
    for k in range(50):
        assert np.array_equal(one.step(1e-3 * np.sin(k)), other.step(1e-3 * np.sin(k)))


def test_shipped_weights_say_how_they_were_made(shipped):
    assert {"recordings", "command", "seed", "settings", "code"} <= set(shipped.training)
    assert all(len(digest) == 64 for digest in shipped.training["recordings"].values())
    assert weights.shipped().stat().st_size < 20_000


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


def test_offline_runs_of_the_plant_trip_and_flag_as_any_other(shipped):
    schedule = Schedule(reference=replace(SINE, amplitude=300.0), gains=(300.0, 15.0), seconds=4.0)
    run = simulate(LearnedPlant(shipped), Bench.nominal(), schedule)
    assert run["flags"][-1] & Flag.TRIPPED
    assert np.any(run["flags"] & Flag.EXTRAPOLATING)


def test_layers_are_views_of_one_vector():
    flat = np.zeros(mlp.count(9, (4, 3), 8))
    mlp.layers(flat, 9, (4, 3), 8).b3[:] = 1.0
    assert flat[-8:].tolist() == [1.0] * 8
    with pytest.raises(ValueError, match="weights for a network"):
        mlp.layers(flat[1:], 9, (4, 3), 8)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--horizon", "0"], "--horizon 0: 1 to 5000 samples are meant"),
        (["--horizon", "5001"], "--horizon 5001: 1 to 5000 samples are meant"),
        (["--stride", "-1"], "--stride -1: 1 sample or more is meant"),
        (["--stride", "0"], "--stride 0: 1 sample or more is meant"),
    ],
)
def test_validate_refuses_a_horizon_or_stride_that_judges_nothing(words, sentence, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["validate", "nowhere", *words])
    with pytest.raises(SystemExit) as ended:
        validate.main()
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]


def test_validate_refuses_a_horizon_that_no_stretch_has_room_for(tmp_path, monkeypatch, capsys):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_states(record_offline(profile("default"), draw(5.0, 4), seed=4).states)
    monkeypatch.setattr("sys.argv", ["validate", str(tmp_path / "bag"), "--horizon", "4900"])
    with pytest.raises(SystemExit) as ended:
        validate.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("error: --horizon 4900: the shortest stretch without a gap has room for 43")
