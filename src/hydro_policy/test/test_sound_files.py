# SPDX-License-Identifier: Apache-2.0
"""Every file that becomes a policy, agent, metric or checkpoint is refused, by name, if it is damaged."""

from __future__ import annotations

import json
import shutil
from argparse import Namespace
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_policy.nodes.training.start import begin_checkpoint, check_run
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs.initial_agent import AGENT, load_initial_agent, shipped_agent
from hydro_policy.runs.run import RunDirectory, load_checkpoint
from hydro_policy.sac.policy import load_policy

SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_paper"))
FILES: dict[str, tuple[Path, Callable[[Path], object]]] = {
    "policy": (SHIPPED / "policy.safetensors", load_policy),
    "agent": (SHIPPED / AGENT, lambda path: load_initial_agent(path.parent)),
    "metric": (
        Path(str(resources.files("hydro_filter") / "data" / "default_metric.safetensors")),
        ScheduledMetric.load,
    ),
}
Tensors = dict[str, Any]


def first(tensors: Tensors) -> str:
    """The largest tensor of floats: one that is used, whatever the file is."""
    return max((name for name, t in tensors.items() if t.dtype.kind == "f"), key=lambda name: tensors[name].size)


def put(number: float) -> Callable[[Tensors], None]:
    def damage(tensors: Tensors) -> None:
        tensors[first(tensors)].flat[-1] = number

    return damage


def take_away(tensors: Tensors) -> None:
    del tensors[first(tensors)]


def shorten(tensors: Tensors) -> None:
    tensors[first(tensors)] = tensors[first(tensors)][:-1].copy()


DAMAGES = {"nan": put(np.nan), "infinity": put(np.inf), "huge": put(1e35), "missing": take_away, "short": shorten}


def damaged(source: Path, folder: Path, damage: Callable[[Tensors], None]) -> Path:
    """A copy of `source` in `folder` with its tensors changed, and all else as it was."""
    path = folder / source.name
    with safe_open(str(source), framework="numpy") as file:
        tensors = {name: file.get_tensor(name).copy() for name in file.keys()}  # noqa: SIM118 - no mapping
        metadata = file.metadata()
    damage(tensors)
    save_file(tensors, str(path), metadata)
    return path


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", FILES)
def test_a_file_whose_numbers_are_damaged_is_refused_by_name(kind: str, damage: str, tmp_path: Path) -> None:
    source, load = FILES[kind]
    if kind == "agent":
        shutil.copy(SHIPPED / "policy.safetensors", tmp_path)
    if kind in ("policy", "agent") and damage == "huge":
        change: Callable[[Tensors], None] = put(3e38)  # float32
    else:
        change = DAMAGES[damage]
    path = damaged(source, tmp_path, change)
    with pytest.raises(ValueError, match=path.name):
        load(path)


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("length", [0, 7, 100, -1])
def test_a_file_that_is_cut_short_is_refused_by_name(kind: str, length: int, tmp_path: Path) -> None:
    source, load = FILES[kind]
    path = tmp_path / source.name
    path.write_bytes(source.read_bytes()[:length])
    with pytest.raises(ValueError, match=path.name):
        load(path)


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    """A run that was killed as soon as its first checkpoint was there."""
    made, start = RunDirectory(tmp_path / "run").create(), shipped_agent("paper")
    assert start is not None
    settings = start.adopted(configuration("paper"))
    begin_checkpoint(made, settings, start)
    made.save_settings(settings)
    return made


def test_a_run_that_was_killed_before_anything_moved_can_be_gone_on_with(run: RunDirectory) -> None:
    checkpoint = load_checkpoint(run.latest)
    check_run(run, run.load_settings(), checkpoint)
    assert (checkpoint.produced, checkpoint.trainer) == (0, {})
    assert load_policy(run.policy)


def test_a_checkpoint_that_is_cut_short_is_refused_in_a_sentence_with_its_place(run: RunDirectory) -> None:
    for name in (AGENT, "replay.npy", "trainer.json"):
        content = (run.latest / name).read_bytes()
        for length in (0, len(content) // 2):
            (run.latest / name).write_bytes(content[:length])
            with pytest.raises(ValueError, match="checkpoints"):
                check_run(run, run.load_settings(), load_checkpoint(run.latest))
        (run.latest / name).write_bytes(content)
    check_run(run, run.load_settings(), load_checkpoint(run.latest))


def poisoned_transitions(run: RunDirectory) -> None:
    rows = np.zeros((10, 30), np.float32)
    rows[3, 4] = np.nan
    np.save(run.latest / "replay.npy", rows)
    (run.latest / "trainer.json").write_text(json.dumps({"produced": 10, "trainer": {}}))


def narrow_transitions(run: RunDirectory) -> None:
    np.save(run.latest / "replay.npy", np.zeros((0, 7), np.float32))


def other_state(run: RunDirectory) -> None:
    (run.latest / "trainer.json").write_text(json.dumps({"produced": 0, "trainer": {"progress": {"episodes": 3}}}))


def truncated_best(run: RunDirectory) -> None:
    content = (run.latest / AGENT).read_bytes()
    (run.best / AGENT).write_bytes(content[:-100])


@pytest.mark.parametrize("damage", [poisoned_transitions, narrow_transitions, other_state, truncated_best])
def test_a_damaged_checkpoint_is_refused_in_a_sentence_with_its_place(
    run: RunDirectory, damage: Callable[[RunDirectory], None]
) -> None:
    damage(run)
    with pytest.raises(ValueError, match="checkpoints"):
        check_run(run, run.load_settings(), load_checkpoint(run.latest))


def test_a_resumed_run_gets_its_own_plant_back(tmp_path: Path) -> None:
    from hydro_policy.nodes.startup.options import plant_options_as_yaml
    from hydro_policy.nodes.trainer import asked, parser

    truth = tmp_path / "truth.yaml"
    truth.touch()
    begun = ["--plant", "emulator", "--truth", str(truth), "--faults", "clean", "--filter=--contraction-rate 2"]
    run = RunDirectory(tmp_path / "run").create()
    run.save_settings(configuration("paper"), plant_options_as_yaml(parser().parse_args(begun)))
    assert run.load_settings() == configuration("paper")

    def plant(*words: str) -> Namespace:
        return asked(["--resume", str(run.path), *words])

    back = plant()
    assert (back.plant, back.truth, back.faults, back.filter) == (
        "emulator", truth, "clean", "--contraction-rate 2"
    )  # fmt: skip
    assert (plant("--rearm", "ask").plant, plant("--rearm", "ask").rearm) == ("emulator", "ask")
    other = plant("--plant", "bench", "--port", "/dev/ttyUSB0")
    assert (other.plant, other.port, other.truth, other.filter) == ("bench", "/dev/ttyUSB0", None, "")
