# SPDX-License-Identifier: Apache-2.0
"""What keeps a training safe, on the running graph: monitor and rollback, over the serial line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.topics import DIAGNOSTICS, create_subscription
from hydro_bridge.signals import Flag
from hydro_policy.runs.run import RunDirectory, load_checkpoint
from tests.graph_probe import Probe, trainer

pytestmark = pytest.mark.graph

SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "warmup_steps:=100", "-p", "exam.every:=0")


@pytest.fixture
def probe(probe: Probe) -> Probe:
    probe.told = {}
    create_subscription(probe.node, DIAGNOSTICS, lambda m: _note(probe, m))
    return probe


def _note(probe: Probe, array: DiagnosticArray) -> None:
    for status in array.status:
        probe.told[status.name] = (status.message, {pair.key: pair.value for pair in status.values})


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
    with trainer(*words, *SHORT, "-p", "monitor.rollbacks_max:=1") as process:
        probe.wait(lambda: "policy stopped in episode 1" in process.text, 150.0)
        probe.wait(lambda: int(probe.told.get("trainer", ("", {}))[1].get("rollbacks", 0)) >= 1, 5.0)
        assert probe.told["trainer"][1]["last stop"] != "none"
        assert process.process.wait(60.0) == 1
    assert "rolled back to the last good one" in process.text
    assert "Training was given up: 2 rollbacks in a row" in process.text
    events = [event for event in json.loads(run.record.read_text())["events"] if event["kind"] in ("stop", "episode")]
    stops = [event for event in events if event["kind"] == "stop"]
    assert [stop["rollbacks"] for stop in stops] == list(range(1, len(stops) + 1))
    # An episode that was completed, because this machine held its gains up, is a good policy: counted anew from there.
    assert [event["kind"] for event in events][-3:] in (["stop"] * 2, ["episode", *["stop"] * 2])
    states = read_bag(run.bag).state
    assert not (states["flags"] & (Flag.TRIPPED | Flag.FORCE_LIMIT)).any(), "the monitor was there first"
    assert not states["flags"][-1] & Flag.ARMED
    learnt = load_checkpoint(run.latest).replay
    assert (learnt[:, -1] == 1.0).sum() == len(stops), "each stop is a lesson"
