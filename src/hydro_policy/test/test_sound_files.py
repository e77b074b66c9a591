# SPDX-License-Identifier: Apache-2.0
"""What is saved is what was; a file of a policy, agent, metric or checkpoint is refused, by name, if it is damaged."""

from __future__ import annotations

import shutil
from argparse import Namespace
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from hydro_core.errors import UserError
from hydro_filter.metric import ScheduledMetric, shipped_metric
from hydro_policy.nodes.plant_options import plant_options_as_yaml
from hydro_policy.nodes.trainer import parse_options, parser
from hydro_policy.nodes.training import write_initial_checkpoint
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs.initial_agent import AGENT_FILE, load_initial_agent, shipped_agent
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.agent import Agent, ReplayBuffer, actor_parameters
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sac.sac import Sac
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE, GainRange

SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_paper"))
FILES: dict[str, tuple[Path, Callable[[Path], object]]] = {
    "policy": (SHIPPED / "policy.safetensors", load_policy),
    "agent": (SHIPPED / AGENT_FILE, lambda path: load_initial_agent(path.parent)),
    "metric": (shipped_metric(), ScheduledMetric.load),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_is_damaged_or_cut_short_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    """Its largest tensor of floats has another number, is short or missing; or bytes are missing of the file."""
    source, read = FILES[kind]
    path, tensors = tmp_path / source.name, load_file(source)
    shutil.copy(SHIPPED / "policy.safetensors", tmp_path)  # beside an agent
    with safe_open(source, framework="numpy") as file:
        metadata = file.metadata()
    name = max((name for name in tensors if tensors[name].dtype.kind == "f"), key=lambda name: tensors[name].size)
    largest = tensors.pop(name)
    damaged = [{name: largest[:-1].copy()}, {}]
    for number in (np.nan, np.inf, 1e35 if kind == "metric" else 3e38):  # float32
        damaged.append({name: largest.copy()})
        damaged[-1][name].flat[-1] = number
    for other in damaged:
        save_file(tensors | other, path, metadata)
        with pytest.raises(ValueError, match=path.name):
            read(path)
    for length in (0, 7, 100, -1):
        path.write_bytes(source.read_bytes()[:length])
        with pytest.raises(ValueError, match=path.name):
            read(path)


def test_a_run_killed_at_once_goes_on_and_a_checkpoint_cut_short_is_refused_with_its_place(tmp_path: Path) -> None:
    run, start = RunDirectory(tmp_path / "run").create(), shipped_agent("paper")
    write_initial_checkpoint(run, start.adapt_settings(configuration("paper")), start)
    checkpoint = load_checkpoint(run.latest)
    assert (checkpoint.produced, checkpoint.trainer) == (0, {})
    assert load_policy(run.policy)
    for name in ("trainer.json", "replay.npy"):
        whole = (run.latest / name).read_bytes()
        (run.latest / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(ValueError, match="checkpoints"):
            load_checkpoint(run.latest)
        (run.latest / name).write_bytes(whole)


def test_a_resumed_run_gets_its_own_plant_back(tmp_path: Path) -> None:
    truth, run = tmp_path / "truth.yaml", RunDirectory(tmp_path / "run").create()
    truth.touch()
    begun = ["--plant", "emulator", "--truth", str(truth), "--faults", "clean", "--filter=--contraction-rate 2"]
    begun += ["--configuration", "wide"]
    run.save_settings(configuration("paper"), plant_options_as_yaml(parser().parse_args(begun)))
    assert run.load_settings() == configuration("paper")

    def plant(*words: str) -> Namespace:
        return parse_options(["--resume", str(run.path), *words])

    back, ask = plant(), plant("--rearm", "ask")
    assert (back.plant, back.truth, back.faults, back.filter) == ("emulator", truth, "clean", "--contraction-rate 2")
    assert (ask.plant, ask.rearm) == ("emulator", "ask")
    other = plant("--plant", "bench", "--port", "/dev/ttyUSB0")
    assert (other.plant, other.port, other.truth, other.filter) == ("bench", "/dev/ttyUSB0", None, "")
    plant("--configuration", "wide", "--seed", "0", "--runs", str(tmp_path), "--name", "run")
    for word, other in (("--seed", "3"), ("--configuration", "paper"), ("--from", "scratch"), ("--name", "other")):
        with pytest.raises(UserError, match=f"{word} {other} is not the run's, .*: omit it"):
            plant(word, other)


def trained(updates: int) -> tuple[Sac, ReplayBuffer]:
    sac, replay = (
        Sac(OBSERVATION_SIZE, ACTION_SIZE, SacSettings(seed=4, batch_size=32)),
        ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, 300),
    )
    rows = np.random.default_rng(0).normal(size=(200, 30)).astype(np.float32)
    rows[:, -1] = 0.0
    replay.extend(rows)
    sac.learn(replay, updates)
    return sac, replay


def test_interrupted_writer_leaves_the_previous_checkpoint(tmp_path: Path) -> None:
    sac, replay = trained(1)
    save_checkpoint(tmp_path / "latest", sac.dump(), replay, {"episode": 1})
    (tmp_path / "latest").rename(tmp_path / "latest.previous")  # as between the writer's two renames
    (tmp_path / "latest.partial").mkdir()
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 1}
    save_checkpoint(tmp_path / "latest", sac.dump(), replay, {"episode": 2})
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 2}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["latest"]


def test_an_agent_to_start_from_brings_its_range_and_owes_no_updates_of_its_past(tmp_path: Path) -> None:
    settings = SacSettings(hidden_size=16, seed=5)
    sac, again = (Agent(OBSERVATION_SIZE, ACTION_SIZE, settings) for _ in range(2))
    sac.updates = 280_000
    (tmp_path / AGENT_FILE).write_bytes(sac.dump())
    policy = Policy(settings)
    policy.load_flat(sac.actor_parameters())
    policy.save(RunDirectory(tmp_path).policy, GainRange(delta_kp_max=285.0), {"task": {"trip_penalty": 100.0}})
    start = load_initial_agent(tmp_path)
    np.testing.assert_array_equal(actor_parameters(start.agent), sac.actor_parameters())
    again.restore(start.agent)
    assert again.updates == 0
    adopted = start.adapt_settings(TrainingSettings())
    assert adopted.sac.hidden_size == 16 and adopted.task.trip_penalty == 100.0
    assert adopted.task.gains == GainRange(delta_kp_max=285.0)
    with pytest.raises(ValueError, match=r"holds no learner\.safetensors"):
        load_initial_agent(tmp_path / "nowhere")
    (tmp_path / AGENT_FILE).write_bytes(b"no agent")
    with pytest.raises(ValueError, match="is not an agent"):
        load_initial_agent(tmp_path)
