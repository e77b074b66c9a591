# SPDX-License-Identifier: Apache-2.0
"""Pretraining run on disk: started or resumed, trained, saved and reported."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from hydro_bridge.bags.recording_run import code_version
from hydro_bridge.cli.console import UserError, progress
from hydro_bridge.cli.resuming import NEW_ONLY, explicit_options, refuse_changes
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.process import endings
from hydro_bridge.viewer.runs import refresh_index
from hydro_policy.envs.environment import Transitions
from hydro_policy.pretraining.configurations import configuration, configuration_of
from hydro_policy.pretraining.options import parser
from hydro_policy.pretraining.report import CURVE, curve_page, curve_table, draw_curve
from hydro_policy.pretraining.source import SimulationSetup, load_simulation_setup, simulation_setup
from hydro_policy.pretraining.training import Pretraining
from hydro_policy.runs.checkpoint import load_checkpoint, save_checkpoint
from hydro_policy.runs.run import RunDirectory, TrainingSettings
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.snapshot import actor_parameters, dump
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.files.stamping import stamped

AGENT = "learner.safetensors"

SAVE_PERIOD = 20.0
"""Minimum s between two checkpoints: a long pretraining's replay buffer is 138 MB on disk."""

REPLAY_MAX = 1_152_000
"""Maximum number of transitions in a pretraining's replay buffer, 138 MB: 640 episodes."""


def pretrain(options: argparse.Namespace) -> int:
    """Run the pretraining of the command line; returns the exit status."""
    torch.set_num_threads(1)  # the work is compiled; torch only draws numbers
    run = RunDirectory(options.resume or options.out)
    if options.resume:
        settings, source = resumed(run, sys.argv[1:])
        raise_if_mismatched(source.trouble())
        pretraining = source.pretraining(settings)
        _resume(run, pretraining)
    else:
        source = simulation_setup(options)
        raise_if_mismatched(source.trouble())
        settings = training_settings(options, source)
        pretraining = source.pretraining(settings)
        _create(run, settings, source)
    began = time.monotonic()
    try:
        _train(run, pretraining, source)
    except KeyboardInterrupt as interruption:
        print(
            f"interrupted after {pretraining.episode} episodes; go on with: pretrain --resume {run.path}",
            file=sys.stderr,
        )
        return endings.status(interruption)
    finally:
        _leave_page(run, pretraining, source)
    _show(run, pretraining, options.json, time.monotonic() - began)
    return 0


def training_settings(options: argparse.Namespace, source: SimulationSetup) -> TrainingSettings:
    """Return the settings of the command line; total gains are the configuration's, whatever the box's base gains."""
    box = source.box_config()
    settings = configuration(options.configuration, options.seed, (box.base_kp, box.base_ki))
    episodes = settings.episodes if options.episodes is None else options.episodes
    hidden = settings.sac.hidden_size if options.hidden is None else options.hidden
    steps = settings.task.steps_per_episode if options.steps is None else options.steps
    updates = settings.updates_per_step if options.updates_per_step is None else options.updates_per_step
    return replace(
        settings,
        made=source.made_for(),
        episodes=episodes,
        updates_per_step=updates,
        replay_capacity=max(settings.replay_capacity, min(episodes * steps, REPLAY_MAX)),
        sac=replace(settings.sac, hidden_size=hidden),
        task=replace(settings.task, steps_per_episode=steps),
    )


def resumed(run: RunDirectory, words: Sequence[str]) -> tuple[TrainingSettings, SimulationSetup]:
    """Return the settings of a resumed run; raises UserError if `words` contradict them. Only --episodes may change."""
    source = load_simulation_setup(run.path)
    settings = replace(run.load_settings(), made=source.made_for())
    begun = {
        **asdict(source), "configuration": configuration_of(settings) or NEW_ONLY, "hidden": settings.sac.hidden_size,
        "steps": settings.task.steps_per_episode, "updates_per_step": settings.updates_per_step, "seed": settings.seed,
    }  # fmt: skip
    refuse_changes(parser(), words, str(run.path), begun)
    episodes = explicit_options(parser(), words).get("episodes", settings.episodes)
    if episodes != settings.episodes:
        settings = replace(settings, episodes=episodes)
        run.save_settings(settings)
    return settings, source


def _create(run: RunDirectory, settings: TrainingSettings, source: SimulationSetup) -> None:
    try:
        run.create().save_settings(settings)
        source.save(run.path)
    except FileExistsError as error:
        raise UserError(str(error)) from error


def _resume(run: RunDirectory, pretraining: Pretraining) -> None:
    if not run.latest.exists() or not any(run.latest.iterdir()):
        return  # interrupted during the first round: it starts again
    best = run.path / AGENT
    pretraining.restore(load_checkpoint(run.latest), best.read_bytes() if best.exists() else None)


def _train(run: RunDirectory, pretraining: Pretraining, source: SimulationSetup) -> None:
    """Run the remaining rounds; checkpoints after the first, the last, and every `SAVE_PERIOD` in between."""
    settings = pretraining.settings.training
    total = settings.episodes * settings.task.steps_per_episode
    bar: tqdm[Any] = progress(total=total, label="pretraining", unit="step")
    bar.update(pretraining.episode * settings.task.steps_per_episode)
    stop, due = _StopRequest(), 0.0

    def each_step(transitions: Transitions) -> None:
        stop.check()
        bar.update(len(transitions.reward))

    while not pretraining.finished:
        entry = pretraining.round(each_step)
        if pretraining.finished or time.monotonic() > due:
            _save(run, pretraining, source)
            due = time.monotonic() + SAVE_PERIOD
        bar.set_postfix_str(f"{entry['score']:.2f} of fixed gains' RMSE, best {pretraining.best_score:.2f}")
    bar.close()


class _StopRequest:
    """Termination request, checked between steps: an exception raised anywhere could be dropped in a finalizer."""

    def __init__(self) -> None:
        self._asked = 0
        endings.answer(self._ask)

    def _ask(self, number: int, frame: object) -> None:
        endings.let_go_of_terminal()
        self._asked = number

    def check(self) -> None:
        """Raise `Ended` if termination was requested."""
        if self._asked:
            raise endings.Ended(self._asked)


def _save(run: RunDirectory, pretraining: Pretraining, source: SimulationSetup) -> None:
    """Save a checkpoint, the best agent so far with its policy, and the learning curve."""
    best = pretraining.best or dump(pretraining.sac)
    training = pretraining.settings.training
    write_whole(run.path / AGENT, stamped(best, training.made))
    policy = Policy(training.sac.hidden_size, (training.sac.log_std_min, training.sac.log_std_max))
    policy.load_flat(actor_parameters(best))
    notes = {
        "command": " ".join(["pretrain", *sys.argv[1:]]), "simulated": asdict(source), "seed": training.seed,
        "episodes": pretraining.episode, "score": pretraining.best_score, "task": asdict(training.task),
        "code": code_version(),
    }  # fmt: skip
    policy.save(run.policy, training.task.gains, notes, training.made)
    save_checkpoint(run.latest, stamped(dump(pretraining.sac), training.made), pretraining.replay, pretraining.state())
    cases = pretraining.settings.evaluation.cases
    draw_curve(pretraining.history, cases, pretraining.reference_rmse, run.path / CURVE)


def _leave_page(run: RunDirectory, pretraining: Pretraining, source: SimulationSetup) -> None:
    """Write report.html in the run's folder, once there is a curve, and the index page of all runs; never fails."""
    if pretraining.history:
        told = {"seed": pretraining.settings.training.seed, "best score": pretraining.best_score}
        about = {**asdict(source), **told, "code_version": code_version()}
        cases = pretraining.settings.evaluation.cases
        with suppress(OSError):
            page = curve_page(run.path, pretraining.history, cases, pretraining.reference_rmse, about)
            write_whole(run.page, page.encode())
    refresh_index(run.path)


def _show(run: RunDirectory, pretraining: Pretraining, json: Path | None, seconds: float) -> None:
    table = curve_table(pretraining.history, pretraining.settings.evaluation.cases, pretraining.reference_rmse)
    table.show(json)
    print(
        f"{run.path}: best score {pretraining.best_score:.3f}, {pretraining.sac.updates} updates, {seconds:.0f} s\n"
        f"policy {run.policy}, learning curve {run.path / CURVE}, page {run.page}",
        file=sys.stderr,
    )
