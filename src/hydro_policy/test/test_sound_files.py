# SPDX-License-Identifier: Apache-2.0
"""What is saved is what was; a file of a policy, agent, metric or checkpoint is refused, by name, if it is damaged."""

from __future__ import annotations

import json
import shutil
from argparse import Namespace
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from hydro_filter.metric import ScheduledMetric
from hydro_policy.nodes.training import begin_checkpoint, check_run
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs.initial_agent import AGENT, load_initial_agent, shipped_agent
from hydro_policy.runs.run import RunDirectory, TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sac.sac import ReplayBuffer, Sac, actor_parameters, dump, restore
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS, GainRange

SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_paper"))
FILES: dict[str, tuple[Path, Callable[[Path], object]]] = {
    "policy": (SHIPPED / "policy.safetensors", load_policy),
    "agent": (SHIPPED / AGENT, lambda path: load_initial_agent(path.parent)),
    "metric": (
        Path(str(resources.files("hydro_filter") / "data" / "default_metric.safetensors")),
        ScheduledMetric.load,
    ),
}


def damaged(source: Path, folder: Path, damage: float | str) -> Path:
    """A copy of `source` in `folder` whose largest tensor of floats has another number, is missing, or is short.

    Or the file itself is: `damage` is how many bytes are left of it.
    """
    path = folder / source.name
    if isinstance(damage, int):
        path.write_bytes(source.read_bytes()[:damage])
        return path
    with safe_open(str(source), framework="numpy") as file:
        tensors = {name: file.get_tensor(name).copy() for name in file.keys()}  # noqa: SIM118 - no mapping
        metadata = file.metadata()
    used = max((name for name, t in tensors.items() if t.dtype.kind == "f"), key=lambda name: tensors[name].size)
    whole = tensors.pop(used)
    if damage == "short":
        tensors[used] = whole[:-1].copy()
    elif damage != "missing":
        whole.flat[-1] = damage
        tensors[used] = whole
    save_file(tensors, str(path), metadata)
    return path


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_is_damaged_or_cut_short_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    source, load = FILES[kind]
    shutil.copy(SHIPPED / "policy.safetensors", tmp_path)
    huge = 1e35 if kind == "metric" else 3e38  # float32
    for damage in (np.nan, np.inf, huge, "missing", "short", 0, 7, 100, -1):
        path = damaged(source, tmp_path, damage)
        with pytest.raises(ValueError, match=path.name):
            load(path)


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    """A run that was killed as soon as its first checkpoint was there."""
    made, start = RunDirectory(tmp_path / "run").create(), shipped_agent("paper")
    settings = start.adapt_settings(configuration("paper"))
    begin_checkpoint(made, settings, start)
    made.save_settings(settings)
    return made


def test_a_run_that_was_killed_before_anything_moved_can_be_gone_on_with(run: RunDirectory) -> None:
    checkpoint = load_checkpoint(run.latest)
    check_run(run, run.load_settings(), checkpoint)
    assert (checkpoint.produced, checkpoint.trainer) == (0, {})
    assert load_policy(run.policy)


def test_a_checkpoint_that_is_cut_short_or_damaged_is_refused_in_a_sentence_with_its_place(run: RunDirectory) -> None:
    def is_refused() -> None:
        with pytest.raises(ValueError, match="checkpoints"):
            check_run(run, run.load_settings(), load_checkpoint(run.latest))

    whole = {name: (run.latest / name).read_bytes() for name in (AGENT, "replay.npy", "trainer.json")}
    for name, content in whole.items():
        for length in (0, len(content) // 2):
            (run.latest / name).write_bytes(content[:length])
            is_refused()
        (run.latest / name).write_bytes(content)
    check_run(run, run.load_settings(), load_checkpoint(run.latest))
    replay, state, rows = run.latest / "replay.npy", run.latest / "trainer.json", np.zeros((10, 30), np.float32)
    state.write_text(json.dumps({"produced": 0, "trainer": {"progress": {"episodes": 3}}}))
    is_refused()  # another state
    rows[3, 4] = np.nan
    np.save(replay, rows)
    state.write_text(json.dumps({"produced": 10, "trainer": {}}))
    is_refused()
    np.save(replay, np.zeros((0, 7), np.float32))
    state.write_bytes(whole["trainer.json"])
    is_refused()  # of another width
    replay.write_bytes(whole["replay.npy"])
    (run.best / AGENT).write_bytes(whole[AGENT][:-100])
    is_refused()


def test_a_resumed_run_gets_its_own_plant_back(tmp_path: Path) -> None:
    from hydro_policy.nodes.plant_options import plant_options_as_yaml
    from hydro_policy.nodes.trainer import parse_options, parser

    truth = tmp_path / "truth.yaml"
    truth.touch()
    begun = ["--plant", "emulator", "--truth", str(truth), "--faults", "clean", "--filter=--contraction-rate 2"]
    run = RunDirectory(tmp_path / "run").create()
    run.save_settings(configuration("paper"), plant_options_as_yaml(parser().parse_args(begun)))
    assert run.load_settings() == configuration("paper")

    def plant(*words: str) -> Namespace:
        return parse_options(["--resume", str(run.path), *words])

    back = plant()
    assert (back.plant, back.truth) == ("emulator", truth)
    assert (back.faults, back.filter) == ("clean", "--contraction-rate 2")
    assert (plant("--rearm", "ask").plant, plant("--rearm", "ask").rearm) == ("emulator", "ask")
    other = plant("--plant", "bench", "--port", "/dev/ttyUSB0")
    assert (other.plant, other.port, other.truth, other.filter) == ("bench", "/dev/ttyUSB0", None, "")


def trained(updates: int) -> tuple[Sac, ReplayBuffer]:
    sac, replay = Sac(OBSERVATIONS, 2, SacSettings(seed=4, batch_size=32)), ReplayBuffer(OBSERVATIONS, 2, 300)
    rows = np.random.default_rng(0).normal(size=(200, 30)).astype(np.float32)
    rows[:, -1] = 0.0
    replay.extend(rows)
    sac.learn(replay, updates)
    return sac, replay


def test_interrupted_writer_leaves_the_previous_checkpoint(tmp_path: Path) -> None:
    sac, replay = trained(1)
    save_checkpoint(tmp_path / "latest", dump(sac), replay, {"episode": 1})
    (tmp_path / "latest").rename(tmp_path / "latest.previous")  # as between the writer's two renames
    (tmp_path / "latest.partial").mkdir()
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 1}
    save_checkpoint(tmp_path / "latest", dump(sac), replay, {"episode": 2})
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 2}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["latest"]


def test_the_acting_policy_equals_the_trained_actor(tmp_path: Path) -> None:
    sac, _ = trained(50)
    policy = Policy(SacSettings())
    policy.load_flat(sac.actor_parameters())
    policy.save(tmp_path / "policy.safetensors", GainRange(delta_kp_max=285.0), {"episode": 7})
    loaded, gains, notes = load_policy(tmp_path / "policy.safetensors")
    assert gains == GainRange(delta_kp_max=285.0) and notes == {"episode": 7}
    observations = np.random.default_rng(1).normal(size=(500, OBSERVATIONS)).astype(np.float32)
    layers = [sac.agent.actor.parameters[places[0]] for layer in sac.layers["actor"] for places in layer]
    hidden = np.maximum(np.maximum(observations @ layers[0] + layers[1], 0.0) @ layers[2] + layers[3], 0.0)
    expected = np.tanh((hidden @ layers[4] + layers[5])[:, :2])
    for actor in (policy, loaded):
        ours = np.stack([actor.act(row.astype(np.float64)) for row in observations])
        np.testing.assert_allclose(ours, expected, atol=1e-6, rtol=0)


def test_an_agent_to_start_from_brings_its_range_and_owes_no_updates_of_its_past(tmp_path: Path) -> None:
    settings = SacSettings(hidden_size=16, seed=5)
    sac = Sac(OBSERVATIONS, ACTIONS, settings)
    sac.updates = 280_000
    (tmp_path / AGENT).write_bytes(dump(sac))
    policy = Policy(SacSettings(hidden_size=16))
    policy.load_flat(actor_parameters(dump(sac)))
    policy.save(RunDirectory(tmp_path).policy, GainRange(delta_kp_max=285.0), {"task": {"trip_penalty": 100.0}})
    start = load_initial_agent(tmp_path)
    np.testing.assert_array_equal(actor_parameters(start.agent), actor_parameters(dump(sac)))
    again = Sac(OBSERVATIONS, ACTIONS, settings)
    restore(again, start.agent)
    assert again.updates == 0
    adopted = start.adapt_settings(TrainingSettings())
    assert adopted.sac.hidden_size == 16 and adopted.task.trip_penalty == 100.0
    assert adopted.task.gains == GainRange(delta_kp_max=285.0)
    with pytest.raises(ValueError, match=r"holds no learner\.safetensors"):
        load_initial_agent(tmp_path / "nowhere")
    (tmp_path / AGENT).write_bytes(b"no agent")
    with pytest.raises(ValueError, match="is not an agent"):
        load_initial_agent(tmp_path)
