# SPDX-License-Identifier: Apache-2.0
"""The learning process as it runs: weights arrive, its end is the run's, its checkpoints hold."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hydro_policy.learner_process.learner import write_run
from hydro_policy.learner_process.supervisor import LearnerError, LearnerSupervisor
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings, load_checkpoint
from hydro_policy.sac.agent import Agent, ReplayBuffer
from hydro_policy.sac.policy import load_policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from tests import checks

SETTINGS = TrainingSettings(learning_starts=100, replay_capacity=2000, sac=SacSettings(batch_size=32))
SIZES = OBSERVATION_SIZE, ACTION_SIZE

wait = partial(checks.wait, timeout=120.0)
"""On a fresh machine the learner compiles first."""


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    made = RunDirectory(tmp_path / "run").create()
    write_run(made, SETTINGS, Agent(*SIZES, SETTINGS.sac).dump(), ReplayBuffer(*SIZES, 200), {})
    return made


@contextmanager
def learning(
    run: RunDirectory, settings: TrainingSettings = SETTINGS, appended: int = 0
) -> Iterator[LearnerSupervisor]:
    learner = LearnerSupervisor(settings, run, appended)
    try:
        wait(lambda: learner.ready or not learner.alive)
        yield learner
    finally:
        with suppress(ProcessLookupError):
            os.kill(learner.pid, signal.SIGKILL)


def append(learner: LearnerSupervisor, count: int) -> None:
    rows = np.random.default_rng(count).normal(size=(count, 30)).astype(np.float32)
    rows[:, -1] = 0.0
    for row in rows:
        learner.append(row)


def test_a_learner_learns_and_leaves_a_checkpoint_from_which_the_next_goes_on(run: RunDirectory) -> None:
    with learning(run) as learner:
        assert learner.new_weights() is not None
        append(learner, 600)
        wait(lambda: learner.ready and learner.status.updates == 500)  # one update per step after the warm-up
        assert learner.new_weights() is not None
        assert learner.new_weights() is None, "the same weights are not news"
        learner.stop({"notes": {"episode": 5}})
        assert not learner.alive
    checkpoint = load_checkpoint(run.latest)
    assert checkpoint.produced == 600 and checkpoint.trainer == {"notes": {"episode": 5}}
    sac = Agent(*SIZES, SETTINGS.sac)
    sac.restore(checkpoint.learner)
    assert sac.updates == 500
    policy, _, notes = load_policy(run.policy)
    np.testing.assert_array_equal(policy.weights[0].astype(np.float32), sac.parts("actor")[0][0])
    assert notes["episode"] == 5
    with learning(run, appended=600) as resumed:
        assert resumed.status.updates == 500
        append(resumed, 100)
        wait(lambda: resumed.ready and resumed.status.updates == 600)


def test_a_rollback_returns_to_the_accepted_candidate_and_keeps_the_count(run: RunDirectory) -> None:
    with learning(run) as learner:
        learner.synchronous = True
        append(learner, 150)
        good = learner.propose()
        append(learner, 100)  # what is proposed is of its time, not of the acceptance's
        learner.accept(best=True)
        learner.wait_for_updates()
        assert np.any(learner.new_weights() != good)
        learner.roll_back()
        learner.save({"episode": 1})
        np.testing.assert_array_equal(learner.new_weights(), good)
        assert learner.status.updates == 150
        best = Agent(*SIZES, SETTINGS.sac)
        best.restore((run.best / "learner.safetensors").read_bytes())
        np.testing.assert_array_equal(best.actor_parameters(), good)
        assert best.updates == 50


def test_a_learner_that_dies_ends_the_run_whose_last_checkpoint_stays(run: RunDirectory) -> None:
    with learning(run) as learner:
        learner.synchronous = True
        learner.save({"episode": 3})
        os.kill(learner.pid, signal.SIGKILL)
        wait(lambda: not learner.alive)
        append(learner, 10)
        learner.wait_for_updates()
        with pytest.raises(LearnerError, match=f"killed by signal 9.*--resume {run.path}"):
            learner.check()
        learner.stop({"episode": 4})
        assert load_checkpoint(run.latest).trainer == {"episode": 3}


def test_a_learner_that_cannot_begin_says_why_at_once(run: RunDirectory) -> None:
    settings = replace(SETTINGS)
    object.__setattr__(settings, "sac", replace(SETTINGS.sac))
    object.__setattr__(settings.sac, "gamma", "much")  # as a setting that only the learner refuses
    with learning(run, settings) as learner, pytest.raises(LearnerError, match="cannot begin: must be real number"):
        learner.check()


def test_a_learner_that_hangs_ends_the_run_and_is_killed(run: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STOP_TIMEOUT", "HANG_TIMEOUT"):
        monkeypatch.setattr(f"hydro_policy.learner_process.supervisor.{name}", 1.0)
    with learning(run) as learner:
        os.kill(learner.pid, signal.SIGSTOP)
        with pytest.raises(LearnerError, match="the learner hangs"):
            while True:
                append(learner, 100)
        learner.stop({"episode": 200})
        assert not learner.alive
        assert load_checkpoint(run.latest).trainer == {}


def test_a_learner_that_diverges_says_so(run: RunDirectory) -> None:
    with learning(run) as learner:
        rows = np.full((200, 30), 1e30, np.float32)
        rows[:, -1] = 0.0
        for row in rows:
            learner.append(row)
        wait(lambda: learner.ready and not learner.alive)
        with pytest.raises(LearnerError, match=r"has ended \(the networks diverged at update"):
            learner.check()
