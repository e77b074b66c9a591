# SPDX-License-Identifier: Apache-2.0
"""Training finds what was there, goes on where it stopped, and splits by time; schedules stay within their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save_file

from hydro_bridge.signals import Flag
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import drawn as schedule
from hydro_sim.files import recordings
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import adam, training
from hydro_sim.identification.checkpoint import Checkpoint
from hydro_sim.model.bench import Bench


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


def test_what_is_no_checkpoint_is_refused(data, tmp_path):
    (tmp_path / "c").write_text("nothing")
    with pytest.raises(DataError, match="no checkpoint"):
        Checkpoint.load(tmp_path / "c")
    save_file({"progress.parameters": np.zeros(3)}, str(tmp_path / "c"), metadata={"hydro": "{}"})
    with pytest.raises(DataError, match="no checkpoint"):
        Checkpoint.load(tmp_path / "c")


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


def test_schedule_keeps_within_its_limits():
    limits = schedule.Range()
    for stretch in schedule.draw(3000.0, 1):
        assert abs(stretch.offset) + stretch.amplitude <= limits.force_max + 1e-3
        assert limits.kp[0] <= stretch.kp <= limits.kp[1]
        assert limits.ki[0] <= stretch.ki <= limits.ki[1]


@pytest.fixture
def begun(data, tmp_path):
    """WEIGHTS whose training was interrupted, and the recordings that it was begun with."""
    model = training.start(data, settings(), Bench.nominal())
    digests = {"one": "12", "two": "34"}
    asked = {"recordings": digests, "bench": None}
    first = Checkpoint(progress=adam.Progress.begin(model.flat), model=model, settings=settings(), asked=asked)
    first.save(tmp_path / "x.checkpoint")
    return tmp_path / "x.safetensors"
