# SPDX-License-Identifier: Apache-2.0
"""Pretraining: the same by seed, resumed or not; the benches it draws; the command."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from hydro_policy.learner_process.learner import write_run
from hydro_policy.pretraining.run import load_simulation_setup
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.initial_agent import load_initial_agent
from hydro_policy.runs.run_directory import RunDirectory
from hydro_policy.sac.agent import Agent, ReplayBuffer
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from tests.checks import ran


def test_an_interrupted_run_ends_with_the_same_weights(pretraining: PretrainSettings, tmp_path: Path) -> None:
    runs = [RunDirectory(tmp_path / name).create() for name in ("whole", "resumed")]
    for run in runs:
        agent = Agent(OBSERVATION_SIZE, ACTION_SIZE, pretraining.training.sac).dump()
        write_run(run, pretraining.training, agent, ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, 1), {})
    begun = Pretraining(pretraining, load_model(), Bench.nominal(), runs[1])
    begun.run_round()
    begun.save({})
    whole, resumed = (Pretraining(pretraining, load_model(), Bench.nominal(), run) for run in runs)
    assert resumed.episode == 2
    for each in (whole, resumed):
        while not each.finished:
            each.run_round()
        each.save({})
    assert resumed.history == whole.history
    for name in (
        "policy.safetensors",
        "checkpoints/latest/learner.safetensors",
        "checkpoints/best/learner.safetensors",
    ):
        assert (runs[0].path / name).read_bytes() == (runs[1].path / name).read_bytes(), name


pretrain = partial(ran, sys.executable, "-m", "hydro_policy.pretraining.pretrain")


def test_command_trains_on_a_bench_with_hidden_states_and_writes_agent_policy_and_learning_curve(
    tmp_path: Path,
) -> None:
    """A valve's lag, friction that holds and a drooping supply bring states of their own."""
    effects = {
        "valve_lag": {"bandwidth": 110.0, "damping": 0.8},
        "friction_coulomb": {"force": 12.0},
        "friction_presliding": {"stiffness": 5e5},
        "supply_droop": {"resistance": 3e10, "time_constant": 0.02},
    }
    file, run, table = tmp_path / "learnt.yaml", tmp_path / "run", tmp_path / "table.json"
    listed = [{"id": name, "parameters": values} for name, values in effects.items()]
    file.write_text(yaml.safe_dump(Bench.nominal().to_mapping() | {"effects": listed}), encoding="utf-8")
    words = ("--episodes", "2", "--steps", "60", "--benches", "2", "--model", file, "--randomise", "--json", table)
    ended = pretrain("--out", run, "--configuration", "wide", *words)
    assert ended.returncode == 0, ended.stderr
    setup = load_simulation_setup(run)
    assert setup.simulated() == Bench.load(file)
    assert setup.provenance().model == "", "a policy is for the box's bench, not for what was simulated"
    policy, gains, notes = load_policy(run / "policy.safetensors")
    assert gains.delta_kp_max == 285.0 and np.isfinite(policy.act(np.zeros(13))).all()
    assert str(notes["command"]).endswith(f"--json {table}")
    assert (run / "learning.png").stat().st_size > 10_000
    assert load_initial_agent(run).reward["error_rate_weight"] == 20.0, "the best agent, on the reward of `wide`"
    assert [row["episode"] for row in json.loads(table.read_text())["rows"]] == ["fixed (90, 15)", "2"]
    again = pretrain("--out", run)
    assert again.returncode == 2 and "holds a run already" in again.stderr
    refused = pretrain("--resume", run, "--steps", "61")
    assert refused.returncode == 2 and "omit --steps, or begin another run" in refused.stderr
    done = pretrain("--resume", run, "--episodes", "4", "--json", table)
    assert done.returncode == 0, done.stderr
    assert [row["episode"] for row in json.loads(table.read_text())["rows"]] == ["fixed (90, 15)", "2", "4"]
