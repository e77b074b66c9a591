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

import numpy as np
import yaml
from tqdm import tqdm

from hydro_bridge.bags.writer import code_version
from hydro_bridge.pages import Section
from hydro_bridge.pages.runs import refresh_index
from hydro_core.bench_scales import rescale
from hydro_core.cli.console import Table, UserError, explicit_options, progress
from hydro_core.files.atomic import write_atomic
from hydro_core.process import termination
from hydro_core.settings import SettingsError, from_mapping, read_yaml
from hydro_policy.envs.environment import Transitions
from hydro_policy.envs.simulation import SimulationSetup
from hydro_policy.pretraining.configurations import CONFIGURATIONS, configuration
from hydro_policy.pretraining.pretrain import parser
from hydro_policy.pretraining.training import REFERENCE_GAINS, Pretraining, PretrainSettings
from hydro_policy.runs.initial_agent import AGENT_FILE
from hydro_policy.runs.report import write_page
from hydro_policy.runs.run_directory import RunDirectory, Scalars, TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.agent import actor_parameters
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.sac import compile_update
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_policy.task.mdp.events import Randomisation
from hydro_sim.files.pairing import raise_if_mismatched, with_provenance
from hydro_sim.model.bench import NOMINAL
from hydro_sim.plotting import BLUE, add_legend, figure

SETUP_FILE = "pretrain.yaml"  # file name in a run's folder, beside config.yaml
CURVE_FILE = "curve.png"  # file name of the learning curve, too
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
    if sentence := compile_update(OBSERVATION_SIZE, ACTION_SIZE, settings.sac.hidden_size):
        print(sentence, file=sys.stderr)
    pretraining = Pretraining(simulation, source.simulated(), source.box_bench())
    if not options.resume:
        run.create().save_settings(settings)
        write_atomic(run.path / SETUP_FILE, yaml.safe_dump(asdict(source), sort_keys=False).encode())
    elif any(run.latest.glob("*")):  # else interrupted during the first round: it starts again
        best = run.path / AGENT_FILE
        pretraining.restore(load_checkpoint(run.latest), best.read_bytes() if best.exists() else None)
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
                curve = Section(heading="Learning curve", picture=run.path / CURVE_FILE)
                sections = [curve, Section(heading="Rounds", table=curve_table(pretraining))]
                write_page(run, f"Pretraining {run.path.name}", {**asdict(source), **told}, sections)
            else:
                refresh_index(run.path)
    curve_table(pretraining).show(options.json)
    print(
        f"{run.path}: best score {pretraining.best_score:.3f}, {pretraining.sac.updates} updates, "
        f"{time.monotonic() - began:.0f} s\n"
        f"policy {run.policy}, learning curve {run.path / CURVE_FILE}, page {run.page}",
        file=sys.stderr,
    )
    return 0


def requested_settings(options: argparse.Namespace) -> tuple[TrainingSettings, SimulationSetup]:
    """Return training settings and simulation set-up of the command line."""
    source = requested_setup(options)
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


def requested_setup(options: argparse.Namespace) -> SimulationSetup:
    """Return the simulation set-up of the command line."""
    model = options.model or "shipped"
    model = model if model in ("analytic", "shipped") else os.path.abspath(model)
    chosen = {name: getattr(options, name) for name in ("base_gains", "integral", "randomise", "filter", "benches")}
    return SimulationSetup(model=model, box=options.box and os.path.abspath(options.box), **chosen)


def resumed_settings(options: argparse.Namespace) -> tuple[TrainingSettings, SimulationSetup]:
    """Return the settings of a resumed run; raises UserError if an option but --episodes is not as at its start."""
    run = RunDirectory(options.resume)
    source = load_simulation_setup(run.path)
    settings = replace(run.load_settings(), made=source.provenance())
    scales = {configuration(name).sac.reward_scale: name for name in CONFIGURATIONS}
    own = asdict(source) | {
        "configuration": scales.get(settings.sac.reward_scale), "hidden": settings.sac.hidden_size,
        "steps": settings.task.steps_per_episode, "updates_per_step": settings.updates_per_step, "seed": settings.seed,
    }  # fmt: skip
    given = {*explicit_options(parser(), sys.argv[1:]), *(("model", "box", "base_gains") if options.site else ())}
    said = vars(options) | asdict(requested_setup(options))
    for name in own.keys() & given:
        if said[name] != own[name]:
            word = f"--{name.replace('_', '-')}"
            raise UserError(f"{word} {said[name]} is not the run's, {own[name]}: omit it, or begin another run")
    if options.episodes is not None:
        settings = replace(settings, episodes=options.episodes)
    run.save_settings(settings)
    return settings, source


def load_simulation_setup(folder: Path) -> SimulationSetup:
    """Return the simulation set-up of a run on disk. Raises UserError: the folder holds no pretraining."""
    try:
        return from_mapping(SimulationSetup, read_yaml(folder / SETUP_FILE), SETUP_FILE)
    except SettingsError as error:
        raise UserError(f"{folder} holds no pretraining to go on with: {error}") from error


def _train(
    run: RunDirectory, pretraining: Pretraining, source: SimulationSetup, noted: Sequence[int]
) -> None:  # fmt: skip
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
            best = pretraining.best or pretraining.sac.dump()
            write_atomic(run.path / AGENT_FILE, with_provenance(best, settings.made))
            policy = Policy(settings.sac, settings.task.size)
            policy.load_flat(actor_parameters(best))
            notes = {
                "command": " ".join(["pretrain", *sys.argv[1:]]), "simulated": asdict(source), "seed": settings.seed,
                "episodes": pretraining.episode, "score": pretraining.best_score, "task": asdict(settings.task),
                "code": code_version(),
            }  # fmt: skip
            policy.save(run.policy, settings.task.gains, notes, settings.made)
            agent = with_provenance(pretraining.sac.dump(), settings.made)
            save_checkpoint(run.latest, agent, pretraining.replay, pretraining.state())
            draw_curve(pretraining, run.path / CURVE_FILE)
            due = time.monotonic() + CHECKPOINT_INTERVAL
        bar.set_postfix_str(f"{entry['score']:.2f} of fixed gains' RMSE, best {pretraining.best_score:.2f}")
    bar.close()


def curve_table(pretraining: Pretraining) -> Table:
    """Return the table with one row per round, the first for fixed gains."""
    history, (kp, ki) = pretraining.history, REFERENCE_GAINS
    names = [case.name for case in pretraining.settings.evaluation.cases]
    drawn = bool(history) and history[0]["changed"] is not None
    columns = {
        "episode": "episodes so far",
        "return": "mean return of the round's episodes",
        "trips": "times a box tripped in them",
        **dict.fromkeys(names, "force RMSE [N] of the mean action"),
        "score": f"mean over cases and benches of the RMSE over that of fixed ({kp:g}, {ki:g}) there",
        **({"changed": "the same over the drawn benches alone"} if drawn else {}),
        "updates": "gradient updates so far",
    }
    table = Table(columns, title="pretraining")
    fixed: dict[str, Any] = dict(zip(names, map(float, pretraining.reference_rmse), strict=True))
    fixed |= {"return": math.nan, "trips": 0, "score": 1.0, "updates": 0} | ({"changed": 1.0} if drawn else {})
    table.add(episode=f"fixed ({kp:g}, {ki:g})", **fixed)
    for entry in history:
        values = {key: entry[key] for key in columns.keys() & entry.keys() - {"episode"}}
        table.add(**values, episode=str(entry["episode"]), **dict(zip(names, entry["rmse"], strict=True)))
    return table


def draw_curve(pretraining: Pretraining, path: Path) -> None:
    """Draw the learning curve: return, and RMSE of the mean action relative to that of fixed gains, over episodes."""
    history, reference = pretraining.history, pretraining.reference_rmse
    episodes = np.array([entry["episode"] for entry in history])
    rmse = np.array([entry["rmse"] for entry in history], np.float64)
    with figure(path, 2, size=(7.0, 5.5), sharex=True) as (_, (returns, ratios)):
        returns.plot(episodes, [-entry["return"] for entry in history], color=BLUE, marker=".")
        returns.set(yscale="log", ylabel="- return")
        for column, case in enumerate(pretraining.settings.evaluation.cases):
            ratios.plot(episodes, rmse[:, column] / reference[column], marker=".", label=case.name)
        changed = [entry["changed"] for entry in history]
        if None not in changed:
            ratios.plot(episodes, changed, color="k", marker=".", label="drawn benches, mean")
        ratios.axhline(1.0, color="0.5", linestyle="--")
        ratios.set(xlabel="episodes", ylabel="RMSE / fixed ({:g}, {:g})".format(*REFERENCE_GAINS))
        add_legend(ratios)
