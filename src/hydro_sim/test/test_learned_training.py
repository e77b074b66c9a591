# SPDX-License-Identifier: Apache-2.0
"""Training finds what was there, goes on where it stopped, and splits by time; schedules stay within their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save_file

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE, Flag, matrix
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import drawn as schedule
from hydro_sim.excitation.coverage import coverage
from hydro_sim.excitation.schedules import load_schedule, save_schedule
from hydro_sim.files import recordings
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import adam, learn, stages, training
from hydro_sim.identification.checkpoint import Checkpoint
from hydro_sim.identification.objectives import StructuredObjective, Windows
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.structured import constants, observer


@pytest.fixture(scope="module")
def recording():
    return record_offline(profile("default"), schedule.draw(24.0, 5), seed=5)


@pytest.fixture(scope="module")
def data(recording):
    return recordings.split({"one": recording.states})


def settings(**changes):
    loop = adam.Settings(epochs=8, validate_every=2, learning_rate=3e-3)
    return replace(training.Settings(structure="network", stride=20, batch=256, adam=loop), **changes)


LONG = adam.Settings(epochs=40, validate_every=5, learning_rate=1e-2)


def trained(data, chosen, path=None, stop=None, model=None):
    """Train; with `path` from the checkpoint that is there, or else leaving some."""
    begun = Checkpoint.load(path) if path is not None and path.exists() else None
    if begun is None:
        model = model or training.start(data, chosen, Bench.nominal())
        begun = Checkpoint(progress=adam.Progress.begin(model.flat), model=model, settings=chosen)

    def keep(state):
        if path is not None:
            replace(begun, progress=state).save(path)

    for last in training.steps(begun.model, data, begun.settings, begun.progress, keep):
        if stop is not None and last[0].epoch >= stop:
            break
    return last


def test_network_learns(data):
    progress, _ = trained(data, settings(adam=LONG))
    errors = progress.history[np.isfinite(progress.history[:, 2]), 2]
    assert errors[-1] < 0.6 * errors[0]


def test_one_step_training_predicts_worse_than_multi_step(data):
    """The ablation that the paper tells of, in small: judged by the same 70-sample predictions."""
    many, _ = trained(data, settings(adam=LONG))
    one, _ = trained(data, settings(horizon=1, stride=1, batch=2048, adam=LONG))
    assert many.best_error < 0.8 * one.best_error


def same(one, other):
    return all(np.array_equal(array, other.arrays()[name], equal_nan=True) for name, array in one.arrays().items())


def test_resumed_training_gives_the_same_numbers(data, tmp_path):
    whole, _ = trained(data, settings())
    trained(data, settings(), tmp_path / "c", stop=4)
    resumed, _ = trained(data, None, tmp_path / "c")
    assert same(resumed, whole)


@pytest.mark.parametrize("structure", ["structured", "residual"])
def test_resumed_training_goes_on_with_the_model_it_was_begun_with(structure, data, tmp_path):
    """The constants that were identified before the loop, and how readings are weighed, are no part of its state."""
    loop = adam.Settings(epochs=4, validate_every=2)
    chosen = training.Settings(structure=structure, hidden=(8, 8), stride=200, batch=64, adam=loop)
    model = training.start(data, chosen, Bench.nominal())
    if structure == "structured":
        model = replace(model, theta=model.theta + 0.01, left=1.5 * model.left, trust=3.0)
    whole, best = trained(data, chosen, model=model)
    trained(data, chosen, tmp_path / "c", stop=2, model=model)
    resumed, again = trained(data, None, tmp_path / "c")
    assert same(resumed, whole)
    tensors = best.tensors()
    assert all(np.array_equal(tensors[name], tensor) for name, tensor in again.tensors().items())
    assert again.header() == best.header()


def test_what_was_identified_is_kept_before_the_first_epoch(data, tmp_path):
    model = training.start(data, settings(), Bench.nominal())
    begun = Checkpoint(progress=adam.Progress.begin(model.flat), model=model, settings=settings())
    begun.save(tmp_path / "new" / "c")
    again = Checkpoint.load(tmp_path / "new" / "c")
    assert same(again.progress, begun.progress) and again.settings == begun.settings


def test_what_is_no_checkpoint_is_refused(data, tmp_path):
    (tmp_path / "c").write_text("nothing")
    with pytest.raises(DataError, match="no checkpoint"):
        Checkpoint.load(tmp_path / "c")
    save_file({"progress.parameters": np.zeros(3)}, str(tmp_path / "c"), metadata={"hydro": "{}"})
    with pytest.raises(DataError, match="no checkpoint"):
        Checkpoint.load(tmp_path / "c")


def test_training_stops_when_validation_no_longer_gets_better(data):
    loop = adam.Settings(epochs=500, validate_every=1, learning_rate=1e-9, patience=3)
    progress, _ = trained(data, settings(adam=loop))
    assert progress.epoch < 20


@pytest.mark.study
def test_identification_finds_the_benchs_constants(data):
    chosen = training.Settings(identify_windows=90)
    start = training.start(data, chosen, Bench.nominal())
    model = stages.fit_constants(start, data, chosen.identify_windows, chosen.seed, lambda _: None)
    c, _ = constants.values(model.table, model.theta)
    found = {entry.name: value for entry, value in zip(model.table, c, strict=True)}
    assert found["friction_coulomb"] == pytest.approx(12.0, rel=0.05)
    assert found["leakage_internal"] == pytest.approx(1e-13, rel=0.05)
    assert found["moving_mass"] == pytest.approx(1.2, rel=0.05)
    assert found["spool_frequency"] == pytest.approx(2.0 * np.pi * 110.0, rel=0.05)


def test_readings_are_weighed_by_what_the_model_leaves_of_them(data):
    shipped = Learned.load().model
    np.testing.assert_allclose(stages.prediction_rms(shipped, data) / observer.READING_NOISE, 1.0, rtol=0.1)
    names = [entry.name for entry in shipped.table]
    theta = shipped.theta.copy()
    theta[names.index("viscous_friction")] += 0.7
    wrong = shipped.with_parameters(theta, shipped.flat)
    left = stages.prediction_rms(wrong, data) / observer.READING_NOISE
    assert left[0] > 2.0 and (left >= 1.0).all()
    objective = StructuredObjective(replace(wrong, left=left), *[Windows(data.validation, 70, 35)] * 2, batch=1, seed=0)
    np.testing.assert_array_equal(objective.weights, 1.0 / left)


def test_splits_by_time_with_a_gap(recording):
    data = recordings.split({"one": recording.states})
    (train,), (validation,) = data.training, data.validation
    assert train.first + len(train) + 1000 <= validation.first
    assert np.array_equal(validation.x, matrix(recording.states)[validation.first : validation.first + len(validation)])


def test_splits_by_recording_where_there_are_three(recording):
    states = recording.states
    data = recordings.split({"a": states[:8000], "b": states[8000:16000], "c": states[16000:]})
    assert [run.name for run in data.training] == ["a", "b"]
    assert [run.name for run in data.validation] == ["c"]


def test_runs_do_not_cross_gaps_or_faults(recording):
    states = np.delete(recording.states, [5000, 5001])
    states["flags"][12000] |= np.uint32(Flag.SENSOR_FAULT)
    states["load_force"][15000] = np.nan
    found = recordings.runs("r", states)
    assert [(run.first, len(run)) for run in found] == [
        (0, 5000),
        (5000, 7000),
        (12001, 2999),
        (15001, len(states) - 15001),
    ]


def test_recordings_without_a_long_run_are_refused():
    with pytest.raises(DataError, match="2000 samples"):
        recordings.split({"empty": np.zeros(10, STATE_DTYPE)})


def test_digest_tells_recordings_apart(recording):
    changed = recording.states.copy()
    changed["load_force"][7] += 1e-9
    assert recordings.digest(recording.states) == recordings.digest(recording.states.copy())
    assert recordings.digest(recording.states) != recordings.digest(changed)


def test_schedule_is_that_of_its_seed():
    assert schedule.draw(100.0, 3) == schedule.draw(100.0, 3)
    assert schedule.draw(100.0, 3) != schedule.draw(100.0, 4)
    assert sum(stretch.seconds for stretch in schedule.draw(100.0, 3)) == pytest.approx(100.0)


def test_schedule_keeps_within_its_limits():
    limits = schedule.Range()
    for stretch in schedule.draw(3000.0, 1):
        assert abs(stretch.offset) + stretch.amplitude <= limits.force_max + 1e-3
        assert limits.kp[0] <= stretch.kp <= limits.kp[1]
        assert limits.ki[0] <= stretch.ki <= limits.ki[1]


def test_schedule_file_is_the_emulators_too(tmp_path):
    drawn = schedule.draw(50.0, 2)
    save_schedule(drawn, tmp_path / "s.yaml")
    assert load_schedule(tmp_path / "s.yaml") == drawn


def test_coverage_counts_what_was_visited(recording):
    still = recording.states.copy()
    still["load_force"] = 0.0
    rows = {row["quantity"]: row["visited"] for row in coverage(recording.states).rows}
    assert rows["load force"] > 0.5
    assert {row["quantity"]: row["visited"] for row in coverage(still).rows}["load force"] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--horizon", "0"], "--horizon is 0, needs 1 or more"),
        (["--hidden", "32", "0"], "--hidden is 0, needs 1 or more"),
        (["--learning-rate", "nan"], "--learning-rate is nan"),
        (["--out", "/dev/null/x.safetensors"], "argument --out: /dev/null/x.safetensors cannot be written"),
    ],
)
def test_learn_refuses_what_cannot_work_before_the_work(words, sentence, tmp_path, monkeypatch, capsys):
    default = ["--out", str(tmp_path / "x.safetensors")]
    monkeypatch.setattr("sys.argv", ["learn", "/no/recording", *default, *words])
    with pytest.raises(SystemExit) as ended:
        learn.main()
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err


@pytest.fixture
def begun(data, tmp_path):
    """WEIGHTS whose training was interrupted, and the recordings that it was begun with."""
    model = training.start(data, settings(), Bench.nominal())
    digests = {"one": "12", "two": "34"}
    asked = {"recordings": digests, "bench": None}
    first = Checkpoint(progress=adam.Progress.begin(model.flat), model=model, settings=settings(), asked=asked)
    first.save(tmp_path / "x.checkpoint")
    return tmp_path / "x.safetensors"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--seed", "3"], "without --seed 3 (it has 0): leave that out"),
        (
            ["--batch", "8192", "--hidden", "8", "8"],
            "without --hidden 8 8 (it has 32 32) and --batch 8192 (it has 256)",
        ),
        (["--structure", "structured"], "without --structure structured (it has network)"),
        (["--bench", "b.yaml"], "without --bench b.yaml (it has none)"),
    ],
)
def test_learn_that_goes_on_is_refused_what_it_was_not_begun_with(words, sentence, begun, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["learn", "/no/recording", "--out", str(begun), "--resume", *words])
    with pytest.raises(SystemExit) as ended:
        learn.main()
    error = capsys.readouterr().err
    assert ended.value.code == 2 and sentence in error and error.count("\n") == 1


def test_learn_goes_on_with_what_it_was_begun_with_and_what_may_change(begun, monkeypatch, capsys):
    words = ["learn", "/no/recording", "--out", str(begun), "--resume", "--batch", "256"]
    monkeypatch.setattr("sys.argv", [*words, "--epochs", "20"])
    kept = learn.resumed(learn.parser().parse_args())
    assert kept.settings == settings(adam=replace(settings().adam, epochs=20))
    begun.with_suffix(".checkpoint").unlink()
    assert learn.resumed(learn.parser().parse_args()) is None
    assert "begins at its beginning" in capsys.readouterr().err


def test_learn_goes_on_with_the_same_recordings_alone(begun, recording, tmp_path, monkeypatch, capsys):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_states(recording.states)
    monkeypatch.setattr("sys.argv", ["learn", str(tmp_path / "bag"), "--out", str(begun), "--resume"])
    with pytest.raises(SystemExit) as ended:
        learn.main()
    assert ended.value.code == 2 and "is of other recordings: one, two" in capsys.readouterr().err


def test_a_training_whose_epochs_are_done_gives_what_it_found(data, tmp_path):
    done, model = trained(data, settings(), tmp_path / "c")
    again, found = trained(data, None, tmp_path / "c")
    assert again.epoch == done.epoch and same(again, done)
    assert np.array_equal(found.flat, model.flat)
