# SPDX-License-Identifier: Apache-2.0
"""The executables as users start them, on a running simulation."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from functools import partial
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.companion import CompanionError, executable_path
from hydro_bridge.ros.topics import BOX, CLAIM_SERVICE, STATE, create_publisher
from hydro_bridge.safety.readiness import NotReadyError, Readiness
from hydro_core.signals import Flag
from hydro_filter.controller.factory import LEARNED
from hydro_msgs.msg import BenchState, BoxInfo
from hydro_msgs.srv import Claim
from hydro_policy.nodes.graph_node import GraphNode
from hydro_policy.nodes.plant_options import NO_FILTER, PlantOptions, box_mismatch
from hydro_policy.nodes.plants import commands
from hydro_policy.runs.run import RunDirectory, load_checkpoint
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import BASE, GainRange
from hydro_sim.files.learned_bench import shipped_bench
from hydro_sim.files.pairing import BoxIdentity, MadeFor
from hydro_sim.model.bench import Bench
from tests.checks import ran, wait

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("domain")]

AT_ONCE = 0.5
"""s from arming to the first gains: a tick and a policy step are 0.06 s, the rest is for a busy machine."""


def run(executable: str, *words: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return ran(executable_path("hydro_policy", executable), *words, timeout=timeout, stdin=subprocess.DEVNULL)


def test_trainer_trains_records_and_says_where_everything_is(tmp_path: Path) -> None:
    short = ("--ros-args", "-p", "task.steps_per_episode:=250", "-p", "learning_starts:=100", "-p", "exam.every:=0")
    words = ("--plant", "sim", "--from", "scratch", "--episodes", "2", "--runs", str(tmp_path), "--name", "a")
    done = run("trainer", *words, *short, timeout=280.0)
    assert done.returncode == 0, done.stderr
    folder = RunDirectory(tmp_path / "a")
    for path in (folder.policy, folder.bag, folder.latest, folder.log):
        assert path.exists() and str(path) in done.stdout
    assert "--resume" in done.stdout and "episode 2/2" in done.stderr
    checkpoint = load_checkpoint(folder.latest)
    assert checkpoint.trainer["episode"] == 2 and checkpoint.trainer["total_steps"] == 500
    episodes = [e for e in json.loads(folder.record.read_text())["events"] if e["kind"] == "episode"]
    better = min(episodes, key=lambda e: float(e["lag"]))["episode"]
    assert len(episodes) == 2 and load_policy(folder.policy)[2]["episode"] == better
    recording = read_bag(folder.bag)
    assert not recording.state["flags"][-1] & Flag.ARMED
    assert len(recording["/hydro/gains"]) >= 500
    armed = np.flatnonzero(recording.state["flags"] & Flag.ARMED)[0]
    assert armed > 0, "the recorder has seen the plant disarmed"
    before = recording.state["flags"][max(0, armed - 200) : armed]
    assert np.mean((before & Flag.FILTER_STALE) == 0) > 0.5, "the filter's corrections reached the plant already"
    acted = recording["/hydro/gains"]["time"][0] - recording.state["time"][armed]
    assert -0.05 < acted < AT_ONCE, "learner, policy and recorder were ready"
    assert recording["/hydro/training"]["updates"].max() > 0  # how many is the machine's affair
    gains, steps = recording["/hydro/gains"], recording["/hydro/policy"][:-1]  # of the last step no gains are sent
    drawn = dict(zip(gains["step"].tolist(), gains["delta_kp"].tolist(), strict=True))
    assert len(steps) >= 500 and set(steps["step"].tolist()) <= set(drawn)
    apart = [drawn[row["step"]] - row["mean_delta_kp"] for row in steps]
    assert np.std(apart) > 0.1 and len(np.unique(steps["weights"])) > 1, "drawn around the mean of weights that learn"
    assert (steps["reward"][1:] < 0.0).sum() >= 498 and np.isnan(steps["reward"][0])
    told = recording["/hydro/training"]
    losses = np.array([told[f"{name}_loss"] for name in ("critic", "actor", "temperature")])
    learnt = np.concatenate(([False], told["updates"][:-1] > 0))
    assert learnt.any() and np.isfinite(losses[:, learnt]).all() and np.isnan(losses[:, told["updates"] == 0]).all()
    assert {"config.yaml", "bench.yaml"} <= set(recording.attachments)
    assert recording.metadata["hydro"]["model_sha256"] == sha256(shipped_bench().read_bytes()).hexdigest()


def test_evaluate_compares_a_policy_with_fixed_gains(tmp_path: Path) -> None:
    policy = tmp_path / "policy.safetensors"
    made = MadeFor(box=Bench.nominal().digest, base_kp=15.0, base_ki=5.0)
    Policy(SacSettings()).save(policy, GainRange(), made=made)  # all zero: mid-range, K_p = 52.5, K_i = 10
    words = ["--plant", "sim", "--policy", str(policy), "--fixed", "52.5", "10", "--fixed", "100", "15"]
    figures, folder = tmp_path / "evaluation.json", RunDirectory(tmp_path / "runs" / "a")
    files = ("--json", str(figures), "--runs", str(folder.path.parent), "--name", "a")
    short = ("--ros-args", "-p", "settle:=1.0", "-p", "measure:=2.0")
    done = run("evaluate", *words, "--frequencies", "2", *files, *short)
    assert done.returncode == 0, done.stderr
    digests = f"weights {load_policy(policy)[0].digest()}, SHA-256 {sha256(policy.read_bytes()).hexdigest()}"
    assert f"policy {policy}: {digests}" in done.stderr
    scores = {score["controller"]: score for score in json.loads(figures.read_text())["runs"]}
    assert list(scores) == ["policy policy", "fixed (52.5, 10)", "fixed (100, 15)", "compensated"], "the default"
    assert "Best: compensated, with 0." in done.stdout, done.stdout
    assert scores["policy policy"]["rmse"] == pytest.approx(scores["fixed (52.5, 10)"]["rmse"], rel=0.15)
    assert scores["fixed (100, 15)"]["proportional_gain"] > 95, "the guard was opened for it"
    assert "2 Hz" in done.stdout and folder.tracking_plot.stat().st_size > 10_000
    assert folder.evaluation.read_text() == figures.read_text() and str(folder.page) in done.stderr
    assert "fixed (100, 15)" in folder.page.read_text()
    assert read_bag(folder.bag).state["flags"].any(), "it records unless told otherwise"
    again = run("evaluate", "--plant", "sim", "--runs", str(folder.path.parent), "--name", "a")
    assert again.returncode == 2 and "choose another --name" in again.stderr.splitlines()[-1]


def test_an_interrupted_evaluation_is_resumed_at_the_trial_that_was_interrupted(tmp_path: Path) -> None:
    folder = RunDirectory(tmp_path / "a")
    words = ["--plant", "sim", "--law", "paper", "--frequencies", "1", "2", "--fixed", "60", "15"]
    short = ("--ros-args", "-p", "settle:=0.5", "-p", "measure:=8.0")
    command = [executable_path("hydro_policy", "evaluate"), *words, "--runs", str(tmp_path), "--name", "a", *short]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as first:
        wait(lambda: folder.record.is_file() and '"trial"' in folder.record.read_text(), 100.0)
        first.send_signal(signal.SIGINT)
        assert first.wait(30.0) == 130
    (made,) = json.loads(folder.evaluation.read_text())["runs"]
    other = run("evaluate", *words, "--resume", str(folder.path), "--ros-args", "-p", "settle:=1.0")
    assert other.returncode == 2 and "compared something else" in other.stderr.splitlines()[-1]
    done = run("evaluate", *words, "--resume", str(folder.path), *short)
    assert done.returncode == 0, done.stderr
    runs = json.loads(folder.evaluation.read_text())["runs"]
    assert runs[0] == made and [one["case"] for one in runs] == ["1 Hz", "2 Hz"] and not runs[1]["stopped"]
    assert len(folder.recordings) == 3, "each has a recording of its own"


class Counted:
    """A session that counts what it gets, and wants more."""

    finished = False
    watch = SimpleNamespace(readiness=Readiness([], print))

    def __init__(self) -> None:
        self.samples = self.ticks = 0

    def on_sample(self, sequence: int, sample: object, flags: int, now: float) -> bool:
        self.samples += 1
        return False

    def on_correction(self, after: float, status: int) -> None: ...

    def on_tick(self, now: float) -> None:
        self.ticks += 1


class SmallPlant:
    """Publishes samples, and gives the authority from when it is told to."""

    def __init__(self) -> None:
        self.node, self.gives, self.asked = rclpy.create_node("plant"), False, 0
        self.states = [create_publisher(self.node, STATE)]
        self.node.create_service(Claim, CLAIM_SERVICE, self._answer)
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def _answer(self, request: Claim.Request, response: Claim.Response) -> Claim.Response:
        self.asked += 1
        response.success, response.claim, response.epoch = self.gives, 5 * self.gives, 7 * self.gives
        response.message = "" if self.gives else "the_first commands this plant"
        return response

    def tick(self) -> None:
        for state in self.states:
            state.publish(BenchState())
        self.executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def newcomer() -> Iterator[tuple[SmallPlant, GraphNode]]:
    rclpy.init()
    plant, node = SmallPlant(), GraphNode("newcomer", realtime=False)
    yield plant, node
    for each in (node, plant.node):  # or they go on publishing as far as the graph knows
        each.destroy_node()
    rclpy.try_shutdown()


def test_samples_of_two_plants_are_not_believed_and_it_is_said_once(
    newcomer: tuple[SmallPlant, GraphNode], capfd: pytest.CaptureFixture[str]
) -> None:
    plant, node = newcomer
    plant.gives, session, before, begun, began = True, Counted(), list[int](), list[float](), time.monotonic()

    def each_tick() -> None:
        plant.tick()
        now = time.monotonic() - began
        if len(plant.states) == 1 and session.samples > 5:
            plant.states.append(create_publisher(plant.node, STATE))
            before.append(session.samples)
            begun.append(now)
        for _ in range(20 if before else 0):
            plant.states[-1].publish(BenchState(flags=int(Flag.TRIPPED)))
        session.finished = now > 20.0 or bool(begun and now > begun[0] + 2.5)

    node.run_session(session, each_tick)  # type: ignore[arg-type]
    assert before and session.samples <= before[0] + 3, "those that came before the second was found"
    assert capfd.readouterr().err.count("nodes publish /hydro/state") == 1


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        (BoxInfo(plant="bridge", base_kp=30.0, base_ki=8.0), "say --base-gains 30 8"),
        (
            BoxInfo(plant="bridge", base_kp=15.0, base_ki=5.0, bench_digest="0123456789ab"),
            "the box believes 0123456789ab",
        ),
        (None, "no node says on /hydro/box"),
    ],
)
def test_a_box_that_is_not_as_planned_or_says_nothing_is_refused_before_anything_is_sent(
    told: BoxInfo | None, sentence: str
) -> None:
    rclpy.init()
    other, node = rclpy.create_node("plant"), GraphNode("newcomer", realtime=False)
    node.box_fault = partial(box_mismatch, BoxIdentity.of_file(None, BASE))
    try:
        state = create_publisher(other, STATE)
        if told is not None:
            create_publisher(other, BOX).publish(told)
        ticking = node.create_timer(0.05, lambda: state.publish(BenchState()))
        with pytest.raises((CompanionError, NotReadyError), match=sentence):
            node.wait_for_plant()
        node.destroy_timer(ticking)
        assert node.timing.response.count == 0
    finally:
        node.destroy_node()
        other.destroy_node()
        rclpy.shutdown()


def test_companions_of_each_plant() -> None:
    started = {
        plant: [executable for _, executable, _ in commands(PlantOptions(plant=plant), GainRange(), Path("run"))]
        for plant in ("sim", "emulator", "bench", "external")
    }
    alone = commands(PlantOptions(plant="bench", filter=NO_FILTER), GainRange(), Path("run"))
    assert [executable for _, executable, _ in alone] == ["bridge"]
    assert started == {
        "sim": ["filtered_plant"],
        "emulator": ["emulator", "filtered_plant"],
        "bench": ["filtered_plant"],
        "external": [],
    }


def test_a_guard_that_is_opened_is_told_what_it_relies_on() -> None:
    wide = commands(PlantOptions(plant="sim"), GainRange(delta_kp_max=285.0), Path("run"))
    assert "guard.delta_kp_max:=285.0" in wide[-1][2]
    assert wide[-1][2][-1] == f"guard.relies_on:=--metric {LEARNED}", "nothing opens the guard in silence"
    named = PlantOptions(plant="sim", filter=("--contraction-rate", "2"))
    started = commands(named, GainRange(delta_kp_max=285.0), Path("run"))
    assert "--filter=--contraction-rate 2" in started[0][2]
    assert started[-1][2][-1] == "guard.relies_on:=--metric learned --contraction-rate 2"
