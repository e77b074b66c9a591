# SPDX-License-Identifier: Apache-2.0
"""Further ways to end a training on the emulator from outside: one sentence, a whole checkpoint, a way on."""

from __future__ import annotations

import os
import signal
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros import STATE, TRAINING
from hydro_bridge.signals import Flag
from hydro_msgs.msg import TrainingStatus
from hydro_policy.nodes.training.start import check_run
from hydro_policy.runs.checkpoint import Checkpoint, load_checkpoint
from hydro_policy.runs.run import RunDirectory
from tests.graph_probe import Probe, Trainer, trainer

pytestmark = [pytest.mark.graph, pytest.mark.study]  # test_graph_failures.py has the others

SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "exam.every:=0")


def start(run: RunDirectory, *words: str) -> AbstractContextManager[Trainer]:
    """A trainer on the emulator with short episodes, from the shipped agent."""
    named = ("--runs", str(run.path.parent), "--name", run.path.name)
    return trainer("--plant", "emulator", *named, *words, *SHORT)


def is_training(probe: Probe) -> bool:
    return bool(probe.heard[TRAINING]) and probe.last(TRAINING).phase == TrainingStatus.TRAINING


def can_be_gone_on_with(run: RunDirectory) -> int:
    """Transitions in the checkpoint, which is whole."""
    assert run.load_plant()["plant"] == "emulator"
    return whole(run).produced


def whole(run: RunDirectory) -> Checkpoint:
    """The checkpoint, which the run can go on from."""
    checkpoint = load_checkpoint(run.latest)
    check_run(run, run.load_settings(), checkpoint)
    return checkpoint


def holds_the_first_episode(run: RunDirectory) -> bool:
    """Whether the checkpoint has what the first episode taught.

    An episode ends at its 300th step that has a reward. Each of these is one transition, unless samples of it were
    lost: 300 in all on a quiet machine, and not one more in the checkpoint at the episode's end. The last checkpoint
    has the beginning of the second episode, too, if that came to a reward.
    """
    checkpoint = whole(run)
    episodes = checkpoint.trainer["progress"]["history"]
    return bool(episodes) and checkpoint.produced >= episodes[0]["whole_steps"] > 0


def ended(process: Trainer, timeout: float = 40.0) -> int:
    """Exit status of a trainer that ends by itself."""
    status = process.process.wait(timeout)
    process.close()
    assert "Traceback" not in process.text and 'File "' not in process.text
    return status


def test_a_run_that_is_killed_before_it_begins_keeps_its_name_and_can_be_gone_on_with(
    probe: Probe, tmp_path: Path
) -> None:
    run = RunDirectory(tmp_path / "run")
    with start(run) as process:
        probe.wait(run.config.exists, 60.0)
        assert process.end(signal.SIGKILL) == -signal.SIGKILL
    assert can_be_gone_on_with(run) == 0
    with trainer("--resume", str(run.path), *SHORT) as process:
        probe.wait(lambda: is_training(probe), 150.0)
        assert process.end() == 130
    assert "plant emulator" in process.text
    assert can_be_gone_on_with(run) > 0


@pytest.mark.parametrize(
    ("name", "outcome"),
    [
        ("bridge", "no samples come from then on"),
        ("emulator", "no samples come from then on"),
    ],
)
def test_a_companion_that_is_killed_ends_the_training(probe: Probe, tmp_path: Path, name: str, outcome: str) -> None:
    run = RunDirectory(tmp_path / "run")
    with start(run) as process:
        probe.wait(lambda: is_training(probe) and probe.last(TRAINING).episode >= 2, 150.0)
        os.kill(process.child(f"/{name} "), signal.SIGKILL)
        assert ended(process) == 2
        assert f"error: {name} ended by itself (killed by SIGKILL): {outcome}" in process.text
    assert can_be_gone_on_with(run) and holds_the_first_episode(run)


def test_a_folder_that_vanishes_is_there_again_with_a_whole_checkpoint(probe: Probe, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "run")
    with start(run, "--no-record") as process:
        probe.wait(lambda: is_training(probe) and probe.last(TRAINING).episode >= 2, 150.0)
        run.path.rename(tmp_path / "away")
        probe.forget()
        assert process.end() == 130
        assert "Traceback" not in process.text and 'File "' not in process.text
    assert can_be_gone_on_with(run) and holds_the_first_episode(run)
    assert not probe.heard[STATE] or not probe.flags() & Flag.ARMED
