# SPDX-License-Identifier: Apache-2.0
"""The executables as users start them, on a running simulation."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import time
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.companion import CompanionError, executable_path
from hydro_bridge.ros.node import leave_graph
from hydro_bridge.ros.topics import BOX, CLAIM_SERVICE, STATE, create_publisher
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.signals import Flag
from hydro_filter.controller.factory import SHIPPED_METRIC
from hydro_msgs.msg import BenchState, BoxInfo
from hydro_msgs.srv import Claim
from hydro_policy.evaluation.runner import Rest
from hydro_policy.nodes.graph_node import GraphNode
from hydro_policy.nodes.plant_options import NO_FILTER_WORDS, PlantOptions, box_mismatch
from hydro_policy.nodes.plants import Graph, executables, plant_graph
from hydro_policy.runs.run_directory import RunDirectory, load_checkpoint
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import BASE_GAINS, GainRange
from hydro_sim.files.learned_bench import shipped_bench
from hydro_sim.files.pairing import BoxIdentity, Provenance
from hydro_sim.model.bench import Bench
from tests.checks import ran, wait

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("domain")]

AT_ONCE = 0.5
"""s from arming to the first gains: a tick and a policy step are 0.06 s, the rest is for a busy machine."""


def run(executable: str, *words: object, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return ran(executable_path("hydro_policy", executable), *words, timeout=timeout, stdin=subprocess.DEVNULL)


def test_trainer_trains_records_and_says_where_everything_is(tmp_path: Path) -> None:
    short = ("--ros-args", "-p", "task.steps_per_episode:=250", "-p", "learning_starts:=100", "-p", "exam.every:=0")
    words = ("--plant", "sim", "--from", "scratch", "--episodes", "2", "--runs", tmp_path, "--name", "a")
    done = run("trainer", *words, *short, timeout=280.0)
    assert done.returncode == 0, done.stderr
    folder = RunDirectory(tmp_path / "a")
    for path in (folder.policy, folder.bag, folder.latest, folder.log):
        assert path.exists()
    assert str(folder.path / "report.html") in done.stdout
    assert "--resume" in done.stdout and "episode 2/2" in done.stderr
    checkpoint = load_checkpoint(folder.latest)
    progress = checkpoint.trainer["progress"]
    assert (progress["episode"], progress["total_steps"]) == (2, 500)
    episodes = [e for e in json.loads(folder.record.read_text())["events"] if e["kind"] == "episode"]
    better = min(episodes, key=lambda e: float(e["lag"]))["episode"]
    assert len(episodes) == 2 and load_policy(folder.policy)[2]["episode"] == better
    recording = read_bag(folder.bag)
    assert {"config.yaml", "bench.yaml"} <= set(recording.attachments)
    assert recording.metadata["hydro"]["model_sha256"] == sha256(shipped_bench().read_bytes()).hexdigest()
    states, gains, told = recording.state, recording["/hydro/gains"], recording["/hydro/training"]
    steps = recording["/hydro/policy"][:-1]  # of the last step no gains are sent
    assert not states["flags"][-1] & Flag.ARMED
    armed = np.flatnonzero(states["flags"] & Flag.ARMED)[0]
    assert armed > 0, "the recorder has seen the plant disarmed"
    before = states["flags"][max(0, armed - 200) : armed]
    assert np.mean((before & Flag.FILTER_STALE) == 0) > 0.5, "the filter's corrections reached the plant already"
    acted = gains["time"][0] - states["time"][armed]
    assert -0.05 < acted < AT_ONCE, "learner, policy and recorder were ready"
    drawn = dict(zip(gains["step"].tolist(), gains["delta_kp"].tolist(), strict=True))
    assert len(steps) >= 500 and set(steps["step"].tolist()) <= set(drawn)
    apart = [drawn[row["step"]] - row["mean_delta_kp"] for row in steps]
    assert np.std(apart) > 0.1 and len(np.unique(steps["weights"])) > 1, "drawn around the mean of weights that learn"
    assert (steps["reward"][1:] < 0.0).sum() >= 498 and np.isnan(steps["reward"][0])
    losses = np.array([told[f"{name}_loss"] for name in ("critic", "actor", "temperature")])
    learnt = np.concatenate(([False], told["updates"][:-1] > 0))  # how many updates is the machine's affair
    assert learnt.any() and np.isfinite(losses[:, learnt]).all() and np.isnan(losses[:, told["updates"] == 0]).all()


def test_an_interrupted_evaluation_is_resumed_and_compares_a_policy_with_fixed_gains(tmp_path: Path) -> None:
    policy = tmp_path / "policy.safetensors"
    made = Provenance(box=Bench.nominal().digest, base_kp=15.0, base_ki=5.0)
    Policy(SacSettings()).save(policy, GainRange(), made=made)  # all zero: mid-range, K_p = 52.5, K_i = 10
    figures, folder = tmp_path / "evaluation.json", RunDirectory(tmp_path / "runs" / "a")
    place = ("--plant", "sim", "--runs", folder.path.parent, "--name", "a")
    words = ("--policy", policy, "--fixed", "52.5", "10", "--fixed", "100", "15", "--frequencies", "2")
    short = ("--json", figures, "--ros-args", "-p", "settle:=0.5", "-p")
    command = map(str, (executable_path("hydro_policy", "evaluate"), *place, *words, *short, "measure:=2.0"))
    with subprocess.Popen([*command], stdin=subprocess.DEVNULL) as first:
        wait(lambda: folder.record.is_file() and '"trial"' in folder.record.read_text(), 100.0)
        first.send_signal(signal.SIGINT)
        assert first.wait(30.0) == 130
    before = json.loads(folder.evaluation.read_text())["runs"]
    assert 1 <= len(before) < 4
    resume = ("--plant", "sim", "--resume", folder.path)
    other = run("evaluate", *resume, *words, *short, "measure:=3.0")
    assert other.returncode == 2 and "compared something else" in other.stderr.splitlines()[-1]
    done = run("evaluate", *resume, *words, *short, "measure:=2.0")
    assert done.returncode == 0, done.stderr
    assert len(folder.recordings) == 3, "each has a recording of its own"
    runs = json.loads(figures.read_text())["runs"]
    assert runs[: len(before)] == before and not any(score["stopped"] for score in runs)
    scores = {score["controller"]: score for score in runs}
    assert list(scores) == ["policy policy", "fixed (52.5, 10)", "fixed (100, 15)", "compensated"], "the default"
    digests = f"weights {load_policy(policy)[0].digest()}, SHA-256 {sha256(policy.read_bytes()).hexdigest()}"
    assert f"policy {policy}: {digests}" in done.stderr
    assert "2 Hz" in done.stdout and "Best: compensated, with 0." in done.stdout, done.stdout
    assert ". Best in a box that has the paper's law alone: fixed (100, 15), with " in done.stdout
    assert scores["policy policy"]["rmse"] == pytest.approx(scores["fixed (52.5, 10)"]["rmse"], rel=0.15)
    assert scores["fixed (100, 15)"]["proportional_gain"] > 95, "the guard was opened for it"
    assert folder.evaluation.read_text() == figures.read_text() and folder.tracking_plot.stat().st_size > 10_000
    assert str(folder.page) in done.stderr and "fixed (100, 15)" in folder.page.read_text()
    assert read_bag(folder.bag).state["flags"].any(), "it records unless told otherwise"
    again = run("evaluate", *place)
    assert again.returncode == 2 and f"{folder.path}: File exists" in again.stderr.splitlines()[-1]


@pytest.fixture
def nodes():
    """A plant's node and one that would command it."""
    rclpy.init()
    made = rclpy.create_node("plant"), GraphNode("newcomer", realtime=False)
    yield made
    for node in reversed(made):  # or they go on in this domain, which another worker's test may take next
        leave_graph(node)
    rclpy.try_shutdown()


def test_samples_of_two_plants_are_not_believed_and_it_is_said_once(nodes, capfd) -> None:
    plant, node = nodes
    session, heard, before = Rest(math.inf, node.supervisor(rearm=True)), [], []
    session.on_sample = lambda *sample: heard.append(sample)
    states = [create_publisher(plant, STATE)]

    def grant(_, answer: Claim.Response) -> Claim.Response:
        answer.success, answer.claim, answer.epoch = True, 5, 7
        return answer

    plant.create_service(Claim, CLAIM_SERVICE, grant)

    def each_tick() -> None:
        for state in states:
            state.publish(BenchState())
        rclpy.spin_once(plant, timeout_sec=0.0)
        if len(heard) > 5 and not before:
            states.append(create_publisher(plant, STATE))
            before.extend((len(heard), time.monotonic()))
        for _ in range(20 if before else 0):
            states[-1].publish(BenchState(flags=int(Flag.TRIPPED)))
        session.finished = bool(before) and time.monotonic() > before[1] + 2.5

    node.run_session(session, each_tick)
    assert len(heard) <= before[0] + 3, "those that came before the second was found"
    assert capfd.readouterr().err.count("nodes publish /hydro/state") == 1


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        (BoxInfo(plant="bridge", base_kp=30.0, base_ki=8.0), "say --base-gains 30 8"),
        (None, "no node describes the box on /hydro/box"),
    ],
)
def test_a_box_that_is_not_as_planned_or_says_nothing_is_refused_before_anything_is_sent(nodes, told, sentence) -> None:
    plant, node = nodes
    node.box_fault = partial(box_mismatch, BoxIdentity.of_file(None, BASE_GAINS))
    state = create_publisher(plant, STATE)
    if told is not None:
        create_publisher(plant, BOX).publish(told)
    node.create_timer(0.05, lambda: state.publish(BenchState()))
    with pytest.raises((CompanionError, NotReadyError), match=sentence):
        node.wait_for_plant()
    assert node.timing.response.count == 0


def test_companions_of_each_plant_and_a_guard_that_is_opened_is_told_what_it_relies_on() -> None:
    def made(plant: str, gains: GainRange | None = None, **more: tuple[str, ...]) -> Graph:
        return plant_graph(PlantOptions(plant=plant, **more), gains or GainRange(), Path("run"))

    def started(plant: str, **more: tuple[str, ...]) -> list[str]:
        return [" ".join(words) for words in executables(made(plant, **more)).values()]

    assert started("sim") == ["hydro_filter filtered_plant sim"]
    assert started("bench") == ["hydro_filter filtered_plant bridge"]
    assert started("emulator") == ["hydro_sim emulator", "hydro_filter filtered_plant bridge"]
    assert started("external") == []
    assert started("bench", filter=NO_FILTER_WORDS) == ["hydro_bridge bridge"]
    wide = GainRange(delta_kp_max=285.0)
    sim = made("sim", wide)["sim"]
    assert sim["guard.delta_kp_max"] == 285.0
    assert sim["guard.relies_on"] == f"metric {SHIPPED_METRIC}", "nothing opens the guard in silence"
    graph = made("sim", wide, filter=("--contraction-rate", "2"))
    assert graph["filter"]["contraction_rate"] == 2.0
    assert graph["sim"]["guard.relies_on"] == f"metric {SHIPPED_METRIC}, contraction_rate 2.0"
