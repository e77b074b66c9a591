# SPDX-License-Identifier: Apache-2.0
"""The live page on a running trainer: it overrides, gives back and ends; and the recording says that it was asked."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("selenium")

import numpy as np

from hydro_bridge.bags.recording import objects, read_bag
from hydro_bridge.ros.topics import DIAGNOSTICS, GAINS, LOG, TRAINING
from hydro_bridge.signals import Flag
from hydro_bridge.viewer.recorded import read_recorded
from hydro_msgs.msg import TrainingStatus
from tests.browser import MISSING, browser
from tests.graph_probe import Probe, trainer
from tests.test_graph_dashboard import ARMED, dashboard

pytestmark = [pytest.mark.graph, pytest.mark.skipif(bool(MISSING), reason=MISSING)]

PAGE = "a person, by the live page"
SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "warmup_steps:=100", "-p", "exam.every:=0")
HELD = (45.0, 5.0)
"""Changes that make (60, 10) of the box's (15, 5)."""


def held(probe: Probe) -> bool:
    if not probe.heard[GAINS]:
        return False
    gains = probe.last(GAINS)
    return bool(np.allclose((gains.delta_kp, gains.delta_ki), HELD))


def test_a_person_overrides_gives_back_and_ends_the_run_and_the_recording_knows_it(
    probe: Probe, tmp_path: Path
) -> None:
    words = ("--plant", "emulator", "--runs", str(tmp_path), "--name", "run")
    with trainer(*words, *SHORT) as process:
        probe.wait(lambda: bool(probe.heard[TRAINING]) and bool(probe.flags() & Flag.ARMED), 200.0)
        with dashboard() as (_, address), browser(tmp_path / "profile") as page:
            page.open(address)
            page.wait(ARMED, timeout=60.0, meanwhile=lambda: probe.spin(0.05))
            for field, text in {"kp": "60", "ki": "10", "seconds": "60"}.items():
                page.enter(field, text)
            page.click("override")
            page.wait("document.getElementById('answer').textContent.includes('(60, 10) for 60 s')")
            probe.wait(lambda: held(probe), 10.0)
            page.wait("document.getElementById('training').textContent.includes('K_p 60, K_i 10')")
            page.enter("kp", "400")
            page.click("override")
            page.wait("document.getElementById('answer').textContent.includes('K_p within [15, 90]')")
            page.click("release")
            page.wait("document.getElementById('answer').textContent.includes('the policy')")
            probe.wait(lambda: not held(probe), 10.0)
            page.click("end")
            probe.spin(0.5)
            assert process.process.poll() is None, "one press is none"
            page.click("end")
            assert process.process.wait(60.0) == 130
    assert probe.last(TRAINING).phase in (TrainingStatus.TRAINING, TrainingStatus.PAUSED, TrainingStatus.WAITING)
    bag = tmp_path / "run" / "bag"
    recording = read_bag(bag)
    assert recording.notes == () and not recording.state["flags"][-1] & Flag.ARMED
    calls = [message.msg for _, message in objects(bag, LOG) if message.name.endswith(".calls")]
    expected = (
        r"trainer: armed for trainer",
        PAGE + r": override, hold \(60, 10\) for 60 s: gains overridden by hand: \(60, 10\) for 60 s",
        PAGE + r": override, hold \(400, 10\) for 60 s: refused: \(400, 10\) cannot be held here: .*",
        PAGE + r": override, give the gains back: override ended: .*",
        r"trainer: disarmed, given back",
    )
    assert [one for one in expected if not any(re.fullmatch(one, call) for call in calls)] == [], calls
    marks = [mark.text for mark in read_recorded(bag).marks if mark.kind == "call"]
    assert "bridge was asked: trainer: armed for trainer" in marks
    digests = {
        pair.value
        for _, message in objects(bag, DIAGNOSTICS)
        for status in message.status
        if status.name == "trainer"
        for pair in status.values
        if pair.key == "policy"
    }
    assert digests and all(re.fullmatch(r"blake2b [0-9a-f]{12}", digest) for digest in digests)
