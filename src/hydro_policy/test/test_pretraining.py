# SPDX-License-Identifier: Apache-2.0
"""Pretraining: the same by seed, resumed or not; the benches it draws; the command."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from hydro_policy.pretraining.run import load_simulation_setup
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.runs.run_directory import load_checkpoint, save_checkpoint
from hydro_policy.sac.policy import load_policy
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from tests.checks import ran


def test_an_interrupted_run_ends_with_the_same_weights(pretraining: PretrainSettings, tmp_path: Path) -> None:
    whole, begun, resumed = (Pretraining(pretraining, load_model(), Bench.nominal()) for _ in range(3))
    begun.run_round()
    save_checkpoint(tmp_path / "latest", begun.sac.dump(), begun.replay, begun.state())
    resumed.restore(load_checkpoint(tmp_path / "latest"), begun.best)
    assert resumed.episode == 2
    for each in (whole, resumed):
        while not each.finished:
            each.run_round()
    np.testing.assert_array_equal(resumed.sac.actor_parameters(), whole.sac.actor_parameters())
    assert resumed.history == whole.history and resumed.best == whole.best


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
    assert (run / "learner.safetensors").exists() and (run / "curve.png").stat().st_size > 10_000
    assert [row["episode"] for row in json.loads(table.read_text())["rows"]] == ["fixed (90, 15)", "2"]
    again = pretrain("--out", run)
    assert again.returncode == 2 and "holds a run already" in again.stderr
    for word, other in (("--model", "analytic"), ("--steps", "61"), ("--configuration", "paper"), ("--seed", "1")):
        refused = pretrain("--resume", run, word, other)
        assert refused.returncode == 2 and f"{word} {other} is not the run's" in refused.stderr
    done = pretrain("--resume", run, "--configuration", "wide", *words)
    assert done.returncode == 0, done.stderr
