# SPDX-License-Identifier: Apache-2.0
"""What goes wrong while a policy is trained on the emulator over the serial link, by the plant's clock.

One training goes through all of it, in the order of the tests, and is gone on with after each end.
"""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.ros.messages import seconds
from hydro_bridge.ros.topics import GAINS, STATE, TRAINING
from hydro_core.signals import Flag
from hydro_msgs.msg import BenchState, TrainingStatus
from hydro_policy.runs.run_directory import Checkpoint, RunDirectory, load_checkpoint
from hydro_policy.sac.agent import Agent
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from tests.checks import ran
from tests.domains import own_domain
from tests.graph_probe import SHORT, Probe, Trainer

pytestmark = pytest.mark.graph


class Training:
    """A training with short episodes, and who watches it."""

    def __init__(self, run: RunDirectory, probe: Probe) -> None:
        self.run, self.probe, self.process = run, probe, None

    def begin(self, stack: ExitStack, *words: str) -> Trainer:
        """Start, and wait until it learns."""
        self.probe.spin(0.5)  # what still waits to be heard is of the training before
        self.probe.forget()
        self.process = stack.enter_context(Trainer("--plant", "emulator", *words))
        self.probe.wait(self.learns, 150.0)
        return self.process

    def resumed(self, stack: ExitStack) -> Trainer:
        """Go on with it, without a recording."""
        process = self.begin(stack, "--resume", str(self.run.path), "--no-record")
        episode = self.probe.last(TRAINING).episode
        self.probe.wait(lambda: self.probe.last(TRAINING).episode > episode, 30.0)
        return process

    def phase(self) -> int:
        return int(self.probe.last(TRAINING).phase) if self.probe.heard[TRAINING] else -1

    def learns(self) -> bool:
        return self.phase() == TrainingStatus.TRAINING and self.probe.last(TRAINING).updates > 0

    def acts(self) -> bool:
        return self.phase() == TrainingStatus.TRAINING and bool(self.probe.flags() & Flag.ARMED)

    def disarmed(self) -> bool:
        return bool(self.probe.heard[STATE]) and not self.probe.flags() & Flag.ARMED

    def checkpoint(self) -> Checkpoint:
        """The latest, which is whole: the run can go on from it."""
        found = load_checkpoint(self.run.latest)
        Agent(OBSERVATION_SIZE, ACTION_SIZE, self.run.load_settings().sac).restore(found.learner)
        return found


@pytest.fixture(scope="module")
def training(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Training]:
    run = RunDirectory(tmp_path_factory.mktemp("graph") / "run")
    with own_domain(), ExitStack() as stack:
        watcher = Probe()
        stack.callback(watcher.close)
        made = Training(run, watcher)
        made.begin(stack, "--from", "scratch", "--runs", str(run.path.parent), "--name", run.path.name, *SHORT)
        yield made


def modified(path: Path) -> float:
    """When it was last modified, or 0 while it is not there: a checkpoint is replaced by two renames."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def test_a_person_takes_the_gains_within_a_step_and_gives_them_back(training: Training) -> None:
    probe, run, override = training.probe, training.run, executable_path("hydro_policy", "override")
    probe.wait(lambda: bool(probe.flags() & Flag.ARMED))
    done = ran(override, "--kp", "60", "--ki", "10", "--seconds", "3")
    assert done.returncode == 0 and "(60, 10) for 3 s" in done.stdout, done.stderr
    probe.wait(lambda: "OVERRIDDEN by hand: K_p 60, K_i 10" in probe.told["trainer"].get("message", ""), 3.0)
    refused = ran(override, "--kp", "400", "--ki", "10")
    assert refused.returncode == 2 and "K_p within [15, 90]" in refused.stderr
    probe.wait(lambda: "override is over" in training.process.text)
    probe.spin(0.5)
    assert ran(override, "--kp", "20", "--ki", "5").returncode == 0
    probe.spin(0.5)
    assert ran(override, "--off").returncode == 0
    ended = probe.last(STATE).sequence
    probe.wait(lambda: read_bag(run.bag).state["sequence"].max() > ended)

    def events() -> list[dict[str, Any]]:
        return [event for event in json.loads(run.record.read_text())["events"] if event["kind"] == "override"]

    probe.wait(lambda: len(events()) == 4)  # taken, over; taken, ended
    bag = read_bag(run.bag)
    gains, states = bag[GAINS], bag.state
    held = np.isclose(gains["delta_kp"], 45.0) & np.isclose(gains["delta_ki"], 5.0)
    first, last = np.flatnonzero(held)[[0, -1]]
    assert held[first : last + 1].all(), "nobody else's gains in between"
    begin, end = gains["time"][[first, last]]
    assert 3.0 - 0.03 < end - begin < 3.0 + 0.02, "from the next policy step on, and for as long as asked for"
    during = (states["time"] > begin + 0.1) & (states["time"] < end)
    assert set(states["proportional_gain"][during]) == {60.0}


def test_unplugged_it_pauses_and_disarms_and_replugged_it_arms_anew(training: Training) -> None:
    probe = training.probe
    probe.wait(training.acts)
    begun, told = len(probe.states), len(training.process.text)
    (training.run.path / "emulator_control").write_text("unplug 1.5\n")
    # Beside other work what waited to be heard may end in samples of a box that has tripped: that is seen first.
    why = re.compile("paused in episode .*: (no samples|tripped|disarmed)")
    probe.wait(lambda: why.search(training.process.text, told))

    def replugged() -> list[BenchState]:
        """First sample after the gap: by the stamps, as samples from before may still wait to be heard."""
        pairs = pairwise(probe.states[begun:])
        return [late for early, late in pairs if seconds(late.header.stamp) - seconds(early.header.stamp) > 1.2]

    probe.wait(replugged)
    assert not replugged()[0].flags & Flag.ARMED, "after the replug the box waits to be armed"
    probe.wait(training.acts)


def test_recorder_killed_training_goes_on_the_user_is_told_and_the_recording_stays_readable(training: Training) -> None:
    probe, process = training.probe, training.process
    probe.spin(0.1)
    sequence = probe.last(STATE).sequence
    probe.spin(3.0)  # it writes to disk each second of the wall clock, in which the plant may take many samples
    os.kill(process.child("/recorder "), signal.SIGKILL)
    probe.wait(lambda: "recorder ended by itself (killed by SIGKILL)" in process.text)
    probe.wait(lambda: probe.told["trainer"]["recording"] == "LOST: end the run, or let it go on unrecorded")
    assert "UNRECORDED" in probe.told["trainer"]["message"]
    probe.forget()
    probe.wait(lambda: training.phase() == TrainingStatus.TRAINING and len(probe.heard[GAINS]) > 150, 60.0)
    assert np.median(np.diff([gains.step for _, gains in probe.heard[GAINS]])) == 1
    states = read_bag(training.run.bag).state
    assert len(states) > 1000
    assert int(states["sequence"][-1]) > sequence, "more than the last seconds is missing"


def test_a_closed_terminal_ends_a_training_as_ctrl_c_does(training: Training) -> None:
    probe, process = training.probe, training.process
    probe.forget()
    probe.spin(0.2)
    told = probe.last(STATE).sequence
    process.process.send_signal(signal.SIGHUP)
    probe.wait(training.disarmed)
    later = ((state.sequence - told, state.flags) for state in probe.states)
    assert next(after for after, flags in later if after > 0 and not flags & Flag.ARMED) < 1000
    assert process.process.wait(40.0) == 130
    assert f"--resume {training.run.path}" in process.text and "Traceback" not in process.text
    checkpoint = training.checkpoint()
    assert checkpoint.produced >= sum(episode["whole_steps"] for episode in checkpoint.trainer["progress"]["history"])


def test_a_disk_that_takes_no_checkpoint_ends_the_training_with_the_one_before(training: Training) -> None:
    first, run = training.checkpoint(), training.run
    stamp = modified(run.latest)
    with ExitStack() as stack:
        process = training.resumed(stack)
        training.probe.wait(lambda: modified(run.latest) > stamp, 60.0)  # of the first episode, whole by then
        before = training.checkpoint().produced
        obstacle = run.latest.with_name("latest.partial")
        stack.callback(obstacle.unlink, missing_ok=True)
        while not obstacle.is_file():  # in the way of the next one, once none is being written
            with suppress(OSError):
                obstacle.touch()
        training.probe.forget()
        training.probe.wait(training.disarmed, 90.0)
        assert process.process.wait(90.0) == 2
    said = [line for line in process.text.splitlines() if line.startswith("error: ")]
    assert len(said) == 1 and "no checkpoint can be written" in said[0] and f"--resume {run.path}" in said[0]
    assert "Traceback" not in process.text and 'File "' not in process.text
    second = training.checkpoint()
    assert second.produced >= before > first.produced
    earlier, later = (each.trainer["progress"] for each in (first, second))
    assert later["history"][: earlier["episode"]] == earlier["history"]


def test_a_learner_that_is_killed_ends_the_training_disarmed_from_whose_checkpoint_it_goes_on(
    training: Training,
) -> None:
    before = training.checkpoint().produced
    with ExitStack() as stack:
        process = training.resumed(stack)
        training.probe.forget()
        os.kill(process.child("spawn_main"), signal.SIGKILL)
        training.probe.wait(training.disarmed, 60.0)
        assert process.process.wait(40.0) == 2
    assert (
        "error: the learner has ended (killed by signal 9): go on from its last checkpoint by --resume" in process.text
    )
    assert "Traceback" not in process.text and 'File "' not in process.text
    assert training.checkpoint().produced > before


def test_a_plant_node_that_is_killed_ends_the_training(training: Training) -> None:
    before = training.checkpoint().produced
    with ExitStack() as stack:
        process = training.resumed(stack)
        os.kill(process.child("/filtered_plant "), signal.SIGKILL)
        assert process.process.wait(40.0) == 2
    said = "filtered_plant ended by itself (killed by SIGKILL): no samples come, and the box disarms"
    assert f"error: {said}" in process.text
    assert "Traceback" not in process.text and 'File "' not in process.text
    assert training.checkpoint().produced > before
