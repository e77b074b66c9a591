# SPDX-License-Identifier: Apache-2.0
"""What `collect` records; how it leaves the plant, whatever happens."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.companion import Companion, executable_path
from hydro_bridge.ros.topics import REFERENCE, STATE, create_subscription
from hydro_core.signals import Flag
from hydro_policy.nodes.collect import SchedulePlan
from hydro_policy.supervision.plant_supervisor import ARM_HINT, EARLY_ARMING_MESSAGE
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.graph_probe import Probe

pytestmark = pytest.mark.usefixtures("domain")


def test_a_schedule_goes_on_behind_a_trip_and_ends_after_three_in_a_row() -> None:
    plan = SchedulePlan([Segment(seconds=1.0, kp=60.0) for _ in range(6)], (15.0, 5.0))
    assert plan.trial is not None and plan.trial.controller.gains(np.zeros(14)) == (45.0, 10.0)
    done, tripped = plan.trial.empty_score(), plan.trial.empty_score("tripped")
    for each in (tripped, tripped, done, tripped, tripped):
        plan.add(each)
    assert plan.trial is not None and not plan.end_reason
    assert (plan.played, plan.done, plan.trips, plan.in_a_row) == (1.0, 5.0, 4, 2)
    plan.add(tripped)
    assert plan.trial is None and "3 times in a row" in plan.end_reason


@pytest.fixture
def plant(start: Callable[..., Companion]) -> Callable[..., Companion]:
    """Starts a simulation; its guard does without a filter."""
    free = ("--ros-args", "-p", "guard.require_filter:=false")
    return partial(start, "hydro_sim sim", "--model", "analytic", *free)


@pytest.fixture
def listener() -> Iterator[Probe]:
    made = Probe()
    yield made
    made.close()


def fresh(listener: Probe) -> int:
    """Flags of a sample that is yet to come."""
    listener.forget()
    listener.wait(lambda: len(listener.heard[STATE]) > 300)
    return listener.flags()


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    """Words of `collect`, to record two seconds of (80, 12) at 300 N in `bag`."""
    segment = {"seconds": 1.0, "waveform": "hold", "offset": 300.0, "kp": 80.0, "ki": 12.0}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({"segments": [segment] * 2}))
    return ["--out", str(tmp_path / "bag"), "--schedule", str(tmp_path / "s.yaml")]


@pytest.mark.graph
def test_a_bench_armed_before_is_recorded_at_rest_before_a_person_is_asked_and_the_recording_says_how_it_was_made(
    plant, listener, words, tmp_path: Path
) -> None:
    plant("-r", "__node:=bench", "-p", "box.base_kp:=60.0", "-p", "box.base_ki:=8.0")
    arm = [str(executable_path("hydro_bridge", "arm"))]
    assert not fresh(listener) & Flag.ARMED
    subprocess.run(arm, timeout=60, check=True)
    output = io.StringIO()
    collect = Companion("hydro_policy", "collect", words, output=output.write)
    listener.wait(lambda: ARM_HINT in collect.last_line)
    assert EARLY_ARMING_MESSAGE in output.getvalue() and not fresh(listener) & Flag.ARMED
    subprocess.run(arm, timeout=30, check=True)
    listener.wait(lambda: not collect.running)
    assert collect.stop() == 0 and not fresh(listener) & Flag.ARMED
    bag = read_bag(tmp_path / "bag")
    assert bag.metadata["hydro"]["plant"] == "hydro sim" and "/diagnostics" in bag.topics
    assert [s["offset"] for s in yaml.safe_load(bag.attachments["schedule.yaml"])["segments"]] == [300.0, 300.0]
    assert yaml.safe_load(bag.attachments["bench.yaml"]) == Bench.nominal().to_mapping()
    armed = (bag.state["flags"] & Flag.ARMED) != 0
    begun = np.flatnonzero(np.diff(armed.astype(int)) == 1)[-1] + 1
    played = bag.state[begun:][armed[begun:]]
    assert len(played) > 1800 and not armed[begun - 900 : begun].any() and not armed[-1]
    assert played["load_force"].max() > 250.0
    for name, gain in (("proportional_gain", 80.0), ("integral_gain", 12.0)):  # arming fades in
        np.testing.assert_allclose(played[name][200:-200], gain, rtol=1e-6, err_msg="in all, whatever the base gains")


@pytest.mark.graph
def test_a_crash_leaves_the_plant_disarmed(plant, listener, words) -> None:
    references: list[Any] = []
    create_subscription(listener.node, REFERENCE, references.append)
    plant()
    crash = (
        "import hydro_bridge.ros.commander as node; from hydro_policy.nodes.collect import main\n"
        "send, sent = node.reference_to_message, []\n"
        "def second(signal, epoch):\n"
        "    sent.append(signal)\n"
        "    if len(sent) == 2: raise KeyError('FOO')\n"
        "    return send(signal, epoch)\n"
        "node.reference_to_message = second\n"
        "main()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", crash, *words], stderr=subprocess.PIPE, text=True)
    listener.wait(lambda: listener.flags() & Flag.ARMED)
    assert "KeyError: 'FOO'" in process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert not fresh(listener) & Flag.ARMED  # at once, not when the guard gives it up after 10 s
    listener.wait(lambda: references[-1].offset == 0.0)
