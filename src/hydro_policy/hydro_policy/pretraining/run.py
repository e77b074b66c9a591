# SPDX-License-Identifier: Apache-2.0
"""Pretraining run on disk: started or resumed, trained, saved and reported."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from hydro_bridge.bags.writer import code_version
from hydro_bridge.pages.runs import refresh_index
from hydro_core.bench_scales import rescale
from hydro_core.cli.console import Table, UserError, explicit_options, progress
from hydro_core.files.atomic import write_atomic
from hydro_core.process import termination
from hydro_core.settings import SettingsError, from_mapping, read_yaml
from hydro_policy.envs.environment import Transitions
from hydro_policy.envs.simulation import SimulationSetup
from hydro_policy.learner_process.learner import write_run
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.pretraining.pretrain import parser
from hydro_policy.pretraining.training import REFERENCE_GAINS, Pretraining, PretrainSettings
from hydro_policy.runs import report
from hydro_policy.runs.run_directory import RunDirectory, RunRecord, Scalars, TrainingSettings
from hydro_policy.sac.agent import Agent, ReplayBuffer
from hydro_policy.sac.sac import compile_update
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_policy.task.mdp.events import Randomisation
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.model.bench import NOMINAL

SETUP_FILE = "pretrain.yaml"  # file name in a run's folder, beside config.yaml
CHECKPOINT_INTERVAL = 20.0  # minimum s between two checkpoints: a long pretraining's replay buffer is 138 MB on disk


def pretrain(options: argparse.Namespace) -> int:
    """Run or resume the pretraining that the command line specifies; returns the exit status."""
    run = RunDirectory(options.resume or options.out)
    settings, source = (resumed_settings if options.resume else requested_settings)(options)
    raise_if_mismatched(source.pairing_error())
    randomisation = rescale(Randomisation(), NOMINAL, settings.task.size) if source.randomise else None
    simulation = PretrainSettings(
        training=settings, benches=source.benches, randomisation=randomisation, filter=source.filter,
        box=source.box_config(), evaluation=EvaluationSettings(amplitude=settings.task.size.force),
    )  # fmt: skip
    benches = source.simulated(), source.box_bench()  # before there is a folder: a file may be unreadable
    if sentence := compile_update(OBSERVATION_SIZE, ACTION_SIZE, settings.sac.hidden_size):
        print(sentence, file=sys.stderr)
    if not options.resume:
        nothing = ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, 1)
        write_run(run.create(), settings, Agent(OBSERVATION_SIZE, ACTION_SIZE, settings.sac).dump(), nothing, {})
        write_atomic(run.path / SETUP_FILE, yaml.safe_dump(asdict(source), sort_keys=False).encode())
    run.save_settings(settings)
    pretraining = Pretraining(simulation, *benches, run)
    began = time.monotonic()
    with termination.signals_noted() as noted:
        try:
            _train(run, pretraining, source, noted)
        except KeyboardInterrupt as interruption:
            again = f"go on with: pretrain --resume {run.path}"
            print(f"interrupted after {pretraining.episode} episodes; {again}", file=sys.stderr)
            return termination.exit_status(interruption)
        finally:
            if pretraining.history:
                told = {"seed": settings.seed, "best score": pretraining.best_score, "code_version": code_version()}
                record = _record(pretraining)
                report.draw_curve(record, run.learning_curve)
                found = report.sections(record, run.learning_curve)[:2]
                report.write_page(run, f"Pretraining {run.path.name}", {**asdict(source), **told}, found)
            else:
                refresh_index(run.path)
    curve_table(pretraining).show(options.json)
    print(
        f"{run.path}: best score {pretraining.best_score:.3f}, {pretraining.learner.sac.updates} updates, "
        f"{time.monotonic() - began:.0f} s\n"
        f"policy {run.policy}, learning curve {run.learning_curve}, page {run.page}",
        file=sys.stderr,
    )
    return 0


def requested_settings(options: argparse.Namespace) -> tuple[TrainingSettings, SimulationSetup]:
    """Return training settings and simulation set-up of the command line."""
    model = options.model or "shipped"
    model = model if model in ("analytic", "shipped") else os.path.abspath(model)
    chosen = {name: getattr(options, name) for name in ("base_gains", "integral", "randomise", "filter", "benches")}
    source = SimulationSetup(model=model, box=options.box and os.path.abspath(options.box), **chosen)
    sac = {} if options.hidden is None else {"hidden_size": options.hidden}
    task = {} if options.steps is None else {"steps_per_episode": options.steps}
    given = {name: getattr(options, name) for name in ("episodes", "updates_per_step")}
    numbers = {name: value for name, value in given.items() if value is not None}
    box = source.box_config()
    settings = configuration(options.configuration, options.seed, (box.base_kp, box.base_ki), source.box_bench().size)
    settings = replace(
        settings, made=source.provenance(), sac=replace(settings.sac, **sac), task=replace(settings.task, **task),
        **numbers,
    )  # fmt: skip
    rows = min(settings.episodes * settings.task.steps_per_episode, 1_152_000)  # 138 MB: 640 episodes
    return replace(settings, replay_capacity=max(settings.replay_capacity, rows)), source


def resumed_settings(options: argparse.Namespace) -> tuple[TrainingSettings, SimulationSetup]:
    """Return the settings of a run to go on with. Raises UserError: it is none, or more than --episodes is given."""
    source = load_simulation_setup(options.resume)
    given = explicit_options(parser(), sys.argv[1:]).keys() - {"resume", "episodes", "json"}
    if given:
        words = ", ".join(f"--{name.replace('_', '-')}" for name in sorted(given))
        raise UserError(
            f"--resume goes on as {options.resume / 'config.yaml'} says: omit {words}, or begin another run"
        )
    settings = replace(RunDirectory(options.resume).load_settings(), made=source.provenance())
    return (settings if options.episodes is None else replace(settings, episodes=options.episodes)), source


def load_simulation_setup(folder: Path) -> SimulationSetup:
    """Return the simulation set-up of a run on disk. Raises UserError: the folder holds no pretraining."""
    try:
        return from_mapping(SimulationSetup, read_yaml(folder / SETUP_FILE), SETUP_FILE)
    except SettingsError as error:
        raise UserError(f"{folder} holds no pretraining to go on with: {error}") from error


def _train(run: RunDirectory, pretraining: Pretraining, source: SimulationSetup, noted: Sequence[int]) -> None:
    """Run the remaining rounds; save the run after the first, the last, and every `CHECKPOINT_INTERVAL` in between."""
    settings = pretraining.settings.training
    total = settings.episodes * settings.task.steps_per_episode
    bar: tqdm[Any] = progress(total=total, label="pretraining", unit="step")
    bar.update(pretraining.episode * settings.task.steps_per_episode)
    due, scalars = 0.0, Scalars(run.path)

    def each_step(transitions: Transitions) -> None:
        if noted:  # polled between steps: an exception raised anywhere could be dropped in a finalizer
            raise termination.Terminated(noted[-1])
        bar.update(len(transitions.reward))

    while not pretraining.finished:
        entry = pretraining.run_round(each_step)
        scalars.add("pretraining", entry)
        if pretraining.finished or time.monotonic() > due:
            command = " ".join(["pretrain", *sys.argv[1:]])
            pretraining.save({"command": command, "simulated": asdict(source), "code": code_version()})
            due = time.monotonic() + CHECKPOINT_INTERVAL
        bar.set_postfix_str(f"{entry['score']:.2f} of fixed gains' RMSE, best {pretraining.best_score:.2f}")
    bar.close()


def _record(pretraining: Pretraining) -> RunRecord:
    """Return the rounds as the episodes and examinations of a training."""
    record = RunRecord()
    for entry in pretraining.history:
        record.add("episode", **entry)
        record.add("exam", **entry)
    return record


def curve_table(pretraining: Pretraining) -> Table:
    """Return the table with one row per round, the first for fixed gains."""
    names = [case.name for case in pretraining.settings.evaluation.cases]
    columns = {
        "episode": "episodes so far",
        "return": "mean return of the round's episodes",
        "trips": "times a box tripped in them",
        **dict.fromkeys(names, "force RMSE [N] of the mean action"),
        "score": "mean over cases and benches of the RMSE over that of fixed ({:g}, {:g}) there".format(
            *REFERENCE_GAINS
        ),
        "updates": "gradient updates so far",
    }
    if pretraining.settings.randomisation is not None:
        columns["changed"] = "the score over the drawn benches alone"
    fixed: dict[str, Any] = {"return": math.nan, "trips": 0, "score": 1.0, "changed": 1.0, "updates": 0}
    fixed |= {"episode": "fixed ({:g}, {:g})".format(*REFERENCE_GAINS), "rmse": pretraining.reference_rmse.tolist()}
    table = Table(columns, title="pretraining")
    for entry in (fixed, *pretraining.history):
        cells = entry | {"episode": str(entry["episode"])} | dict(zip(names, entry["rmse"], strict=True))
        table.add(**{key: cells[key] for key in columns})
    return table
