# SPDX-License-Identifier: Apache-2.0
"""What keeps a training safe, on the running graph: monitor, rollback and a person's override, over the serial line."""

from __future__ import annotations

import json
import os
import subprocess
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros import DIAGNOSTICS, DIAGNOSTICS_QOS, GAINS, TRAINING, executable_path
from hydro_bridge.signals import Flag
from hydro_msgs.msg import TrainingStatus
from hydro_policy.runs.checkpoint import load_checkpoint
from hydro_policy.runs.run import RunDirectory
from tests.graph_probe import Probe, trainer

pytestmark = pytest.mark.graph

SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "warmup_steps:=100", "-p", "exam.every:=0")


@pytest.fixture
def probe(probe: Probe) -> Probe:
    probe.told = {}
    probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, lambda m: _note(probe, m), DIAGNOSTICS_QOS)
    return probe


def _note(probe: Probe, array: DiagnosticArray) -> None:
    for status in array.status:
        probe.told[status.name] = (status.message, {pair.key: pair.value for pair in status.values})


def override(*words: str) -> subprocess.CompletedProcess[str]:
    command = [str(executable_path("hydro_policy", "override")), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=30.0, env=dict(os.environ), check=False)


def is_training(probe: Probe) -> bool:
    return bool(probe.heard[TRAINING]) and probe.last(TRAINING).phase == TrainingStatus.TRAINING


def test_a_person_takes_the_gains_within_a_step_and_gives_them_back(probe: Probe, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "run")
    with trainer(
        "--plant", "emulator", "--from", "scratch", "--runs", str(tmp_path), "--name", "run", *SHORT
    ) as process:
        probe.wait(lambda: is_training(probe) and bool(probe.flags() & Flag.ARMED), 150.0)
        probe.spin(1.0)
        probe.forget()
        done = override("--kp", "60", "--ki", "10", "--seconds", "3")
        assert done.returncode == 0 and "(60, 10) for 3 s" in done.stdout, done.stderr
        probe.wait(lambda: "OVERRIDDEN by hand: K_p 60, K_i 10" in probe.told.get("trainer", ("",))[0], 3.0)
        refused = override("--kp", "400", "--ki", "10")
        assert refused.returncode == 2 and "K_p within [15, 90]" in refused.stderr
        probe.wait(lambda: "override is over" in process.text, 6.0)
        probe.spin(0.5)
        assert "gains overridden by hand" in process.text
        assert override("--kp", "20", "--ki", "5").returncode == 0
        probe.spin(0.5)
        assert override("--off").returncode == 0
        probe.spin(0.5)
        assert process.end() == 130
    events = [event for event in json.loads(run.record.read_text())["events"] if event["kind"] == "override"]
    assert len(events) == 4, "taken, over; taken, ended"
    bag = read_bag(run.bag)
    gains = bag[GAINS]
    held = np.isclose(gains["delta_kp"], 45.0) & np.isclose(gains["delta_ki"], 5.0)
    first, last = np.flatnonzero(held)[[0, -1]]
    assert held[first : last + 1].all(), "nobody else's gains in between"
    # Counted in policy steps, not in milliseconds: one may be under way, and a busy machine may stand still in between.
    told, times = _when(events[0]), gains["time"]
    assert ((times > told) & (times < times[first])).sum() <= 1, "from the next policy step on"
    assert (held & (times > told + 3.0)).sum() <= 1, "not longer than asked for"
    assert times[last + 1] - told > 3.0 - 0.02, "and for so long nobody else's"
    states = bag.state
    during = (states["time"] > gains["time"][first] + 0.1) & (states["time"] < gains["time"][last])
    fresh = (states["flags"] & (Flag.WATCHDOG | Flag.FILTER_STALE)) == 0
    assert np.median(states["proportional_gain"][during & fresh]) == 60.0
    # Every transition that was learnt from holds gains of the policy: two actions in a row never are the override's.
    rows = load_checkpoint(run.latest).replay
    actions, wanted = rows[:, 26:28], np.array([2 * 45 / 75 - 1, 2 * 5 / 10 - 1])
    assert len(rows) > 50 and not np.isclose(actions, wanted, atol=1e-5).all(axis=1).any()
    assert not states["flags"][-1] & Flag.ARMED


def _when(event: dict[str, str]) -> float:
    return datetime.fromisoformat(event["time"]).timestamp()


def test_an_unstable_policy_is_stopped_before_the_box_trips_and_after_too_many_rollbacks_the_run_ends(
    probe: Probe, tmp_path: Path
) -> None:
    """With K_p up to 300 the middle of the range, where a policy from scratch starts, is more than the bench bears.

    With the constant metric, that is: the learned one would hold it. Without updates, for a learner that is quick finds
    bearable gains after the second stop, which is well done and no case for giving up.
    """
    run = RunDirectory(tmp_path / "run")
    words = ("--plant", "emulator", "--from", "scratch", "--configuration", "wide", "--filter=--metric constant")
    words += ("--updates-per-step", "0", "--runs", str(tmp_path), "--name", "run")
    with trainer(*words, *SHORT, "-p", "monitor.rollbacks_max:=2") as process:
        probe.wait(lambda: "policy stopped in episode 1" in process.text, 150.0)
        probe.wait(lambda: int(probe.told.get("trainer", ("", {}))[1].get("rollbacks", 0)) >= 1, 5.0)
        assert probe.told["trainer"][1]["last stop"] != "none"
        assert process.process.wait(60.0) == 1
    assert "rolled back to the last good one" in process.text
    assert "Training was given up: 3 rollbacks in a row" in process.text
    events = [event for event in json.loads(run.record.read_text())["events"] if event["kind"] in ("stop", "episode")]
    stops = [event for event in events if event["kind"] == "stop"]
    assert [stop["rollbacks"] for stop in stops] == list(range(1, len(stops) + 1))
    # An episode that was completed, because this machine held its gains up, is a good policy: counted anew from there.
    assert [event["kind"] for event in events][-4:] in (["stop"] * 3, ["episode", *["stop"] * 3])
    states = read_bag(run.bag).state
    assert not (states["flags"] & (Flag.TRIPPED | Flag.FORCE_LIMIT)).any(), "the monitor was there first"
    assert not states["flags"][-1] & Flag.ARMED
    learnt = load_checkpoint(run.latest).replay
    assert (learnt[:, -1] == 1.0).sum() == len(stops), "each stop is a lesson"
