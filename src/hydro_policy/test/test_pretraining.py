# SPDX-License-Identifier: Apache-2.0
"""Pretraining: the same by seed, resumed or not; the benches it draws; the command."""

from __future__ import annotations

import json
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_policy.pretraining.run import load_simulation_setup
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.run import TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.policy import load_policy
from hydro_policy.sac.sac import dump
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import TaskSettings
from hydro_policy.task.mdp.events import Randomisation, draw_bench
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from tests.checks import ran


def short() -> Pretraining:
    training = TrainingSettings(
        episodes=4, seed=1, learning_starts=40, replay_capacity=2000,
        task=TaskSettings(steps_per_episode=60), sac=SacSettings(batch_size=32, seed=1),
    )  # fmt: skip
    evaluation = EvaluationSettings(frequencies=(2.0,), settle=0.5, measure=0.5)
    settings = PretrainSettings(training=training, benches=2, evaluation=evaluation)
    return Pretraining(settings, load_model(), Bench.nominal())


def finished(pretraining: Pretraining) -> Pretraining:
    while not pretraining.finished:
        pretraining.round()
    return pretraining


def test_an_interrupted_run_ends_with_the_same_weights(tmp_path: Path) -> None:
    whole = finished(short())
    begun = short()
    begun.round()
    save_checkpoint(tmp_path / "latest", dump(begun.sac), begun.replay, begun.state())
    resumed = short()
    resumed.restore(load_checkpoint(tmp_path / "latest"), begun.best)
    assert resumed.episode == 2
    finished(resumed)
    np.testing.assert_array_equal(resumed.sac.actor_parameters(), whole.sac.actor_parameters())
    assert resumed.history == whole.history
    assert resumed.best == whole.best


def test_a_drawn_learned_bench_has_the_numbers_that_were_drawn() -> None:
    learned, limits = load_model(), Randomisation()
    before = learned.constants()[0]
    for seed in range(20):
        drawn = draw_bench(limits, learned, seed)
        after = drawn.plant.model.bench.constants()[0]
        assert after["spring_stiffness"] == pytest.approx(drawn.spring, rel=1e-3)  # the learned ratio is of both
        assert limits.spring_min <= drawn.spring <= limits.spring_max
        assert limits.supply_min <= after["supply_pressure"] <= limits.supply_max
        assert 0.9 <= after["bulk_modulus"] / before["bulk_modulus"] <= 1.1
        assert after["piston_area"] == before["piston_area"]
        assert 1 <= drawn.gain_delay <= limits.gain_delay_max and 0 <= drawn.dead_time <= 1


pretrain = partial(ran, sys.executable, "-m", "hydro_policy.pretraining.pretrain")


def test_command_writes_an_agent_its_policy_and_the_learning_curve(tmp_path: Path) -> None:
    run, table = tmp_path / "run", tmp_path / "table.json"
    words = ["--episodes", "2", "--steps", "60", "--benches", "2", "--model", "analytic", "--json", str(table)]
    ended = pretrain("--out", str(run), "--configuration", "wide", *words)
    assert ended.returncode == 0, ended.stderr
    policy, gains, notes = load_policy(run / "policy.safetensors")
    assert gains.delta_kp_max == 285.0
    assert notes["command"].endswith("--json " + str(table))  # type: ignore[union-attr]
    assert math.isfinite(float(policy.act(np.zeros(13))[0]))
    assert (run / "learner.safetensors").exists() and (run / "curve.png").stat().st_size > 10_000
    assert [row["episode"] for row in json.loads(table.read_text())["rows"]] == ["fixed (90, 15)", "2"]
    again = pretrain("--out", str(run))
    assert again.returncode == 2 and "holds a run already" in again.stderr
    done = pretrain("--resume", str(run), *words)
    assert done.returncode == 0, done.stderr


def test_a_bench_file_with_hidden_states_is_trained_on(tmp_path: Path) -> None:
    """A valve's lag, friction that holds and a drooping supply bring states of their own."""
    effects = [
        {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}},
        {"id": "friction_coulomb", "parameters": {"force": 12.0}},
        {"id": "friction_presliding", "parameters": {"stiffness": 5e5}},
        {"id": "supply_droop", "parameters": {"resistance": 3e10, "time_constant": 0.02}},
    ]
    file, run = tmp_path / "learnt.yaml", tmp_path / "run"
    file.write_text(yaml.safe_dump(Bench.nominal().to_mapping() | {"effects": effects}), encoding="utf-8")
    words = ["--episodes", "2", "--steps", "60", "--benches", "2", "--model", str(file), "--randomise"]
    ended = pretrain("--out", str(run), *words)
    assert ended.returncode == 0, ended.stderr
    assert load_simulation_setup(run).simulated() == Bench.load(file)
    assert load_simulation_setup(run).made_for().model == "", (
        "a policy is for the box's bench, not for what was simulated"
    )
