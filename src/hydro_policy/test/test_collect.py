# SPDX-License-Identifier: Apache-2.0
"""What `collect` records; how it leaves the plant, whatever happens."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.companion import Companion, executable_path
from hydro_bridge.ros.topics import GRAPH, REFERENCE, STATE
from hydro_core.signals import Flag
from hydro_policy.nodes.collect import SchedulePlan
from hydro_policy.supervision.plant_supervisor import HOW_TO_ARM, TOO_EARLY
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.checks import ran, wait
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


def _collect(folder: Path, segments: list[dict[str, object]], *words: str) -> list[str]:
    (folder / "s.yaml").write_text(yaml.safe_dump({"segments": segments}))
    return ["--out", str(folder / "bag"), "--schedule", str(folder / "s.yaml"), *words]


HOLD = {"seconds": 1.0, "waveform": "hold", "offset": 300.0, "kp": 60.0}


@pytest.mark.graph
def test_the_recording_says_how_it_was_made_and_the_plant_is_left_disarmed_at_0_n(
    plant: Callable[..., None], listener: Probe, tmp_path: Path
) -> None:
    plant("-p", "box.base_kp:=60.0", "-p", "box.base_ki:=8.0")
    words = _collect(tmp_path, [{**HOLD, "kp": 80.0, "ki": 12.0}] * 2)
    ended = subprocess.run([str(executable_path("hydro_policy", "collect")), *words], timeout=60, check=False)
    assert ended.returncode == 0
    listener.wait(lambda: listener.heard[STATE])
    assert not fresh(listener) & Flag.ARMED
    bag = read_bag(tmp_path / "bag")
    assert bag.metadata["hydro"]["plant"] == "sim"
    assert [s["offset"] for s in yaml.safe_load(bag.attachments["schedule.yaml"])["segments"]] == [300.0, 300.0]
    assert yaml.safe_load(bag.attachments["bench.yaml"]) == Bench.nominal().to_mapping()
    assert bag.state["load_force"].max() > 250.0
    assert bag.state["flags"][-1] & Flag.ARMED == 0
    played = bag.state[(bag.state["flags"] & Flag.ARMED) != 0][200:-200]  # arming fades in
    gains = {(round(float(s["proportional_gain"]), 6), round(float(s["integral_gain"]), 6)) for s in played}
    assert gains == {(80.0, 12.0)}, "in all, whatever the box's base gains"
    assert "/diagnostics" in bag.topics


@pytest.mark.graph
def test_a_crash_leaves_the_plant_disarmed(plant: Callable[..., None], listener: Probe, tmp_path: Path) -> None:
    references: list[Any] = []
    listener.node.create_subscription(GRAPH[REFERENCE][0], REFERENCE, references.append, GRAPH[REFERENCE][1])
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
    words = _collect(tmp_path, [HOLD, HOLD])
    process = subprocess.Popen([sys.executable, "-c", crash, *words], stderr=subprocess.PIPE, text=True)
    listener.wait(lambda: listener.flags() & Flag.ARMED)
    assert "KeyError: 'FOO'" in process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert not fresh(listener) & Flag.ARMED  # at once, not when the guard gives it up after 10 s
    listener.wait(lambda: references[-1].offset == 0.0)


@pytest.mark.graph
def test_a_bench_that_was_armed_before_is_disarmed_and_recorded_at_rest_before_a_person_is_asked(
    plant: Callable[..., None], listener: Probe, tmp_path: Path
) -> None:
    plant("-r", "__node:=bench")
    arm = [str(executable_path("hydro_bridge", "arm"))]
    assert not fresh(listener) & Flag.ARMED
    subprocess.run(arm, timeout=60, check=True)
    output = io.StringIO()
    collect = Companion("hydro_policy", "collect", _collect(tmp_path, [HOLD]), output=output.write)
    listener.wait(lambda: HOW_TO_ARM in collect.last_line)
    assert TOO_EARLY in output.getvalue() and not fresh(listener) & Flag.ARMED
    subprocess.run(arm, timeout=30, check=True)
    listener.wait(lambda: not collect.running)
    assert collect.stop() == 0
    armed = (read_bag(tmp_path / "bag").state["flags"] & Flag.ARMED) != 0
    begun = np.flatnonzero(np.diff(armed.astype(int)) == 1)[-1] + 1
    assert armed[begun:].sum() > 900 and not armed[begun - 900 : begun].any()


@pytest.mark.graph
def test_beside_another_who_commands_it_refuses_to_start(
    plant: Callable[..., None], listener: Probe, tmp_path: Path
) -> None:
    plant()
    listener.take()
    collect = [str(executable_path("hydro_policy", "collect")), *_collect(tmp_path, [HOLD])]
    with subprocess.Popen(collect, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        listener.wait(lambda: process.poll() is not None, 60.0)
        assert process.returncode == 2 and process.stderr is not None
        assert process.stderr.read().splitlines()[-1].startswith("error: probe commands this plant: end it")
    assert not (tmp_path / "bag").exists()


@pytest.mark.graph
def test_a_bench_file_that_is_not_the_boxs_is_refused(plant: Callable[..., None], tmp_path: Path) -> None:
    own = replace(Bench.nominal(), spring_stiffness=2.5e4)
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(own.to_mapping()))
    (tmp_path / "nominal.yaml").write_text(yaml.safe_dump(Bench.nominal().to_mapping()))
    plant("--", "--bench", str(tmp_path / "own.yaml"))
    words = (*_collect(tmp_path, [HOLD]), "--bench", tmp_path / "nominal.yaml")
    refused = ran(executable_path("hydro_policy", "collect"), *words, timeout=60)
    assert refused.returncode == 2
    assert f"the box believes {own.digest}" in refused.stderr.splitlines()[-1]
    assert not (tmp_path / "bag").exists()


@pytest.mark.graph
def test_interrupted_before_anything_is_played_it_leaves_no_folder(plant: Callable[..., None], tmp_path: Path) -> None:
    plant()
    output = io.StringIO()
    collect = Companion("hydro_policy", "collect", _collect(tmp_path, [HOLD]), output=output.write)
    wait(lambda: (tmp_path / "bag").exists(), 60.0)
    assert collect.stop(30.0) == 2
    assert collect.last_line == "error: interrupted: nothing was played"
    assert not (tmp_path / "bag").exists()
