# SPDX-License-Identifier: Apache-2.0
"""What goes wrong while a policy is trained on the emulator over the serial link, and what the user is told."""

from __future__ import annotations

import os
import signal
import time
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros import GAINS, STATE, TRAINING, seconds
from hydro_bridge.signals import Flag
from hydro_msgs.msg import TrainingStatus
from hydro_policy.runs.checkpoint import load_checkpoint
from hydro_policy.runs.run import RunDirectory
from tests.graph_probe import Probe, Trainer, trainer

pytestmark = pytest.mark.graph

SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "warmup_steps:=100", "-p", "exam.every:=0")


def phase(probe: Probe) -> int:
    return int(probe.last(TRAINING).phase) if probe.heard[TRAINING] else -1


def start(run: Path, *words: str) -> AbstractContextManager[Trainer]:
    """A trainer on the emulator with short episodes."""
    run_words = ("--runs", str(run.parent), "--name", run.name)
    return trainer("--plant", "emulator", "--from", "scratch", *run_words, *words, *SHORT)


def is_learning(probe: Probe) -> bool:
    return phase(probe) == TrainingStatus.TRAINING and probe.last(TRAINING).updates > 0


def test_learner_killed_acting_goes_on_and_learning_restarts_from_its_last_weights(
    probe: Probe, tmp_path: Path
) -> None:
    with start(tmp_path / "run") as run:
        probe.wait(lambda: is_learning(probe), 150.0)
        begun = probe.last(TRAINING).updates
        probe.spin(1.5)
        before = probe.last(TRAINING).updates
        probe.forget()
        killed = time.time()
        os.kill(run.child("spawn_main"), signal.SIGKILL)
        probe.wait(lambda: "learner lost (killed by signal 9)" in run.text, 5.0)
        probe.spin(3.0)
        probe.wait(lambda: is_learning(probe) and probe.last(TRAINING).updates > before, 30.0)
        after = [message.updates for _, message in probe.heard[TRAINING]]
        # A snapshot twice a second; a learner that catches up makes thousands of updates in that time.
        assert before - min(after) <= (before - begun) / 1.5 + 128, "less than the last second is learnt again"
        assert run.end() == 130
    assert load_checkpoint(RunDirectory(tmp_path / "run").latest).produced > 0
    gains = read_bag(tmp_path / "run" / "bag")[GAINS]
    during = gains[(gains["time"] > killed) & (gains["time"] < killed + 3.0)]
    # Waiting for a new learner would take seconds; a loaded machine may stall for a moment of its own.
    assert np.diff(during["time"]).max() < 0.5
    assert len(during) == pytest.approx(300, rel=0.1)
    assert np.median(np.diff(during["step"].astype(int))) == 1


def test_unplugged_it_pauses_and_disarms_replugged_it_arms_anew_and_ctrl_c_leaves_a_run_to_resume(
    probe: Probe, tmp_path: Path
) -> None:
    run = RunDirectory(tmp_path / "run")
    with start(run.path) as process:
        probe.wait(lambda: is_learning(probe), 150.0)
        (run.path / "emulator_control").write_text("unplug 1.5\n")
        probe.wait(lambda: phase(probe) == TrainingStatus.PAUSED, 5.0)
        paused = time.time()
        probe.wait(lambda: "paused in episode" in process.text and "no samples" in process.text, 5.0)
        # Samples from before may still wait to be heard: a sample's stamp tells.
        back = probe.wait_for(STATE, lambda state: seconds(state.header.stamp) > paused, 15.0)
        assert not back.flags & Flag.ARMED, "after the replug the box waits to be armed"
        probe.wait(lambda: phase(probe) == TrainingStatus.TRAINING and bool(probe.flags() & Flag.ARMED), 20.0)
        probe.spin(1.0)
        assert process.end() == 130
        assert f"--resume {run.path}" in process.text
    first = load_checkpoint(run.latest)
    assert first.trainer["progress"]["interruptions"] >= 1, "a loaded machine may add its own"
    states = read_bag(run.bag).state
    assert not states["flags"][-1] & Flag.ARMED, "disarmed before it ended"
    probe.spin(1.0)
    probe.forget()
    with trainer("--plant", "emulator", "--resume", str(run.path), "--no-record") as process:
        probe.wait(lambda: is_learning(probe), 150.0)
        probe.wait(lambda: probe.last(TRAINING).episode > first.trainer["episode"] + 1, 30.0)
        assert process.end(signal.SIGTERM) == 130
    second = load_checkpoint(run.latest)
    assert second.produced > first.produced
    assert second.trainer["progress"]["history"][: first.trainer["episode"]] == first.trainer["progress"]["history"]


def test_recorder_killed_training_goes_on_the_user_is_told_and_the_recording_stays_readable(
    probe: Probe, tmp_path: Path
) -> None:
    run = RunDirectory(tmp_path / "run")
    with start(run.path) as process:
        probe.wait(lambda: is_learning(probe), 150.0)
        recorder = process.child("/recorder ")
        probe.spin(0.1)
        sequence = probe.last(STATE).sequence
        os.kill(recorder, signal.SIGKILL)
        probe.wait(lambda: "recorder ended by itself (killed by SIGKILL)" in process.text, 5.0)
        for _ in range(5):  # anew where the machine stood still
            probe.forget()
            probe.spin(2.0)
            if phase(probe) == TrainingStatus.TRAINING and len(probe.heard[GAINS]) > 150:
                break
        else:
            pytest.fail("training does not go on at its pace")
        assert process.end() == 130
    states = read_bag(run.bag).state
    assert len(states) > 1000
    assert sequence - int(states["sequence"][-1]) < 1000, "more than a second is missing"
