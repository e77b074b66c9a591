# SPDX-License-Identifier: Apache-2.0
"""What keeps a training safe, on the running graph: monitor and rollback, over the serial line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import DIAGNOSTICS, STATE, create_subscription
from hydro_bridge.signals import Flag
from hydro_policy.runs.run import RunDirectory, load_checkpoint
from tests.graph_probe import SHORT, Probe, trainer

pytestmark = pytest.mark.graph


@pytest.fixture
def probe(probe: Probe) -> Probe:
    probe.told = {}
    create_subscription(probe.node, DIAGNOSTICS, lambda m: _note(probe, m))
    return probe


def _note(probe: Probe, array: DiagnosticArray) -> None:
    for status in array.status:
        probe.told[status.name] = (status.message, {pair.key: pair.value for pair in status.values})


@contextmanager
def unfiltered(port: Path) -> Iterator[None]:
    """An emulated bench that lets the gains of `wide` pass, whatever its filter says, which decides nothing."""
    limits = ("require_filter:=false", "delta_kp_max:=285.0", "delta_ki_max:=95.0", "relies_on:=the monitor")
    words = [word for limit in limits for word in ("-p", f"guard.{limit}")]
    with (
        Companion("hydro_sim", "emulator", ["--link", str(port)]),
        Companion("hydro_bridge", "bridge", ["--port", str(port), "--ros-args", *words]),
        Companion("hydro_filter", "filter", ["--bypass"]),
    ):
        yield


def test_an_unstable_policy_is_stopped_before_the_box_trips_and_after_too_many_rollbacks_the_run_ends(
    probe: Probe, tmp_path: Path
) -> None:
    """With K_p up to 300 the middle of the range, where a policy from scratch starts, is more than the bench bears.

    Without a filter, that is: it would hold it. Without updates, for a learner that is quick finds
    bearable gains after the second stop, which is well done and no case for giving up.
    """
    run = RunDirectory(tmp_path / "run")
    words = ("--plant", "external", "--rearm", "auto", "--from", "scratch", "--configuration", "wide")
    words += ("--updates-per-step", "0", "--runs", str(tmp_path), "--name", "run")
    rollbacks = ("-p", "monitor.rollbacks_max:=1")
    with unfiltered(tmp_path / "port"), trainer(*words, *SHORT, *rollbacks) as process:
        probe.wait(lambda: "policy stopped in episode 1" in process.text, 150.0)
        probe.wait(lambda: int(probe.told.get("trainer", ("", {}))[1].get("rollbacks", 0)) >= 1, 5.0)
        assert probe.told["trainer"][1]["last stop"] != "none"
        assert process.process.wait(60.0) == 1
        probe.wait(lambda: not probe.flags() & Flag.ARMED, 5.0)
    assert "rolled back to the last good one" in process.text
    assert "Training was given up: 2 rollbacks in a row" in process.text
    events = [event for event in json.loads(run.record.read_text())["events"] if event["kind"] in ("stop", "episode")]
    stops = [event for event in events if event["kind"] == "stop"]
    assert [stop["rollbacks"] for stop in stops] == list(range(1, len(stops) + 1))
    # An episode that was completed, because this machine held its gains up, is a good policy: counted again from there.
    assert [event["kind"] for event in events][-3:] in (["stop"] * 2, ["episode", *["stop"] * 2])
    flags = np.array([state.flags for _, state in probe.heard[STATE]])
    assert (flags & Flag.ARMED).any()
    assert not (flags & (Flag.TRIPPED | Flag.FORCE_LIMIT)).any(), "the monitor was there first"
    learnt = load_checkpoint(run.latest).replay
    assert (learnt[:, -1] == 1.0).sum() == len(stops), "each stop is a lesson"
