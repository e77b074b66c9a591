# SPDX-License-Identifier: Apache-2.0
"""The learning process as it runs: weights arrive, its death costs nothing, its checkpoints hold."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hydro_policy.learner_process.supervisor import LearnerError, LearnerSupervisor
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings, load_checkpoint
from hydro_policy.sac.agent import Agent
from hydro_policy.sac.policy import load_policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from tests import checks

SETTINGS = TrainingSettings(learning_starts=100, replay_capacity=2000, sac=SacSettings(batch_size=32))


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    return RunDirectory(tmp_path / "run").create()


def transitions(count: int) -> np.ndarray:
    rows = np.random.default_rng(count).normal(size=(count, 30)).astype(np.float32)
    rows[:, -1] = 0.0
    return rows


wait = partial(checks.wait, timeout=120.0)
"""On a fresh machine the learner compiles first."""


def kill(learner: LearnerSupervisor) -> None:
    os.kill(learner.pid, signal.SIGKILL)
    wait(lambda: not learner.alive)


def test_learner_learns_dies_revives_and_leaves_a_checkpoint(run: RunDirectory) -> None:
    learner = LearnerSupervisor(SETTINGS, run)
    wait(lambda: learner.ready)
    assert learner.new_weights() is not None
    learner.replay.extend(transitions(600))
    wait(lambda: learner.updates == 500)  # one update per step after the warm-up
    assert learner.new_weights() is not None
    assert learner.new_weights() is None, "the same weights are not news"
    kill(learner)
    learner.replay.extend(transitions(100))  # acting goes on meanwhile
    message = learner.restart_if_dead()
    assert message is not None and "signal 9" in message and learner.restarts == 1
    assert learner.restart_if_dead() is None
    wait(lambda: learner.ready)
    assert learner.updates >= 500, "it starts from the last state, not from nothing"
    wait(lambda: learner.updates == 600)
    learner.stop({"episode": 5})
    assert not learner.alive
    checkpoint = load_checkpoint(run.latest)
    assert checkpoint.produced == 700 and checkpoint.trainer == {"episode": 5}
    sac = Agent(OBSERVATION_SIZE, ACTION_SIZE, SETTINGS.sac)
    sac.restore(checkpoint.learner)
    assert sac.updates == 600
    policy, _, notes = load_policy(run.policy)
    np.testing.assert_array_equal(policy.weights[0].astype(np.float32), sac.parts("actor")[0][0])
    assert notes["episode"] == 5

    resumed = LearnerSupervisor(SETTINGS, run, checkpoint)
    wait(lambda: resumed.ready)
    assert resumed.updates == 600 and resumed.replay.total_appended == 700
    kill(resumed)
    resumed.stop({"episode": 6})  # nobody there: the acting side writes the checkpoint itself
    assert load_checkpoint(run.latest).trainer == {"episode": 6}


def test_a_learner_that_cannot_begin_says_why_at_once(run: RunDirectory) -> None:
    with pytest.raises(ValueError, match="not a whole agent"):
        LearnerSupervisor(SETTINGS, run, start=Agent(OBSERVATION_SIZE, ACTION_SIZE, SETTINGS.sac).dump()[:-100])
    settings = replace(SETTINGS)
    object.__setattr__(settings, "sac", replace(SETTINGS.sac))
    object.__setattr__(settings.sac, "gamma", "much")  # as a setting that only the learner refuses
    learner = LearnerSupervisor(settings, run)
    wait(lambda: not learner.alive)
    with pytest.raises(LearnerError, match="the learner cannot begin: too many dimensions"):
        learner.restart_if_dead()
    learner.stop({})
    assert not run.policy.exists(), "there was nothing to write"


def test_a_learner_that_hangs_is_waited_for_by_nobody_and_the_last_checkpoint_is_written_without_it(
    run: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hydro_policy.learner_process.supervisor.STOP_TIMEOUT", 1.0)
    learner = LearnerSupervisor(SETTINGS, run)
    wait(lambda: learner.ready)
    os.kill(learner.pid, signal.SIGSTOP)
    history = [{"episode": k, "whole_steps": 1800, "force_rmse": 1.0 / 3.0} for k in range(160)]
    heard = [learner.save({"episode": k, "history": history}) for k in range(200)]  # two megabytes
    assert heard[0] and not heard[-1]
    before = learner.checkpoints
    learner.roll_back()
    os.kill(learner.pid, signal.SIGCONT)
    wait(lambda: learner.checkpoints == before + sum(heard))
    learner.restart_if_dead()
    wait(lambda: learner.new_weights() is not None)  # it has gone back, though it did not hear of it at first
    os.kill(learner.pid, signal.SIGSTOP)
    learner.stop({"episode": 200})
    assert not learner.alive
    assert load_checkpoint(run.latest).trainer == {"episode": 200}


def test_learner_that_keeps_dying_is_given_up(run: RunDirectory) -> None:
    learner = LearnerSupervisor(SETTINGS, run)
    with pytest.raises(LearnerError, match="died 6 times"):
        for _ in range(6):
            kill(learner)
            learner.restart_if_dead()
