# SPDX-License-Identifier: Apache-2.0
"""Preparation of a training run: folder, settings, initial agent, companions, record."""

from __future__ import annotations

import argparse
import shlex
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np

from hydro_bridge.cli.console import writable_folder
from hydro_bridge.ros.companion import start_page
from hydro_bridge.ros.node import refuse_unknown_parameters
from hydro_bridge.size import resized
from hydro_policy.learner_process.learner import SaveRequest, write_run
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.nodes.startup.box_expectation import (
    box_mismatch,
    expected_box,
    require_matching_agent,
    require_same_box,
    training_provenance,
)
from hydro_policy.nodes.startup.companions import (
    LOAD_FORCE,
    guard_range,
    protection_gap,
    requested_filter,
    start_companions,
)
from hydro_policy.nodes.startup.options import (
    SCRATCH,
    choose_plant,
    declare_settings,
    load_cell,
    plant_options,
    plant_options_as_yaml,
    unless_said,
)
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs.initial_agent import AGENT, InitialAgent, load_initial_agent, shipped_agent
from hydro_policy.runs.run import Checkpoint, RunDirectory, RunRecord, TrainingSettings, load_checkpoint
from hydro_policy.sac.algorithm import Sac
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.snapshot import check_agent, dump
from hydro_policy.sessions.run_state import Progress
from hydro_policy.supervision.override import GainOverride
from hydro_policy.task.mdp import ACTIONS, BASE, OBSERVATIONS
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.model.bench import NOMINAL

UPDATES_PER_STEP = {"scratch": 8.0, "agent": 1.0}
"""Updates per step. From scratch: above the paper's 1, since bench time is costly; a good agent would degrade."""


@dataclass(frozen=True)
class Prepared:
    """A prepared run."""

    run: RunDirectory
    settings: TrainingSettings
    checkpoint: Checkpoint | None
    start: InitialAgent | None
    made: bool = False
    """Whether the run's folder was newly created."""

    @property
    def best(self) -> bytes | None:
        """Best agent of the resumed run, if it has one."""
        path = self.run.best / AGENT
        return path.read_bytes() if self.checkpoint is not None and path.is_file() else None


def prepare(options: argparse.Namespace, node: GraphNode) -> Prepared:
    """Prepare a new run with its folder and first checkpoint, or one to resume.

    Invalid input is refused before anything is created.
    """
    start, box = None, expect_box(options, node)
    load_cell(options)
    if options.resume is not None:
        run = RunDirectory(options.resume)
        writable_folder(run.path)
        settings, checkpoint = run.load_settings(), load_checkpoint(run.latest)
        check_run(run, settings, checkpoint)
    else:
        run = RunDirectory(options.runs / (options.name or f"{datetime.now():%Y%m%d-%H%M%S}"))
        checkpoint = None
        writable_folder(run.path)
        run.refuse_existing()
        start = find_initial_agent(options)
        require_matching_agent(start, box)
        updates = UPDATES_PER_STEP["agent" if start else "scratch"]
        configured = configuration(options.configuration, base=box.base_gains or BASE, size=box.size or NOMINAL)
        settings = replace(configured, updates_per_step=updates)
        settings = start.adopted(settings) if start else settings
    given = {name: getattr(options, name) for name in ("episodes", "updates_per_step", "seed")}
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})
    if options.seed is not None:
        settings = replace(settings, sac=replace(settings.sac, seed=options.seed))
    if options.exam_every is not None:
        settings = replace(settings, exam=replace(settings.exam, every=options.exam_every))
    settings = declare_settings(node, settings)
    refuse_unknown_parameters(node)
    if not options.plant_named:  # last of the checks: it takes seconds, or a person
        options.plant = choose_plant(node)
        box = expect_box(options, node)
        require_matching_agent(start, box)
    if options.plant == "external":
        box = wait_for_box(node)
        require_matching_agent(start, box)
        if options.resume is None:
            size = settings.task.size
            settings = unless_said(node, settings, resized(settings, size, box.size or size))
        if start is None and options.resume is None:
            settings = rebase_gains(settings, box, node)
    if options.resume is not None:
        require_same_box(run.path, settings.made, box)
    settings = replace(settings, made=training_provenance(box))
    made = not run.path.exists()
    if options.resume is None:
        run.create()
        begin_checkpoint(run, settings, start)
    run.save_settings(
        settings, plant_options_as_yaml(options)
    )  # last: a folder without it is not a run, and its name is free
    return Prepared(run, settings, checkpoint, start, made)


def expect_box(options: argparse.Namespace, node: GraphNode) -> BoxIdentity:
    """Return the expected box, other than which the node rejects."""
    box = expected_box(options)
    if options.plant != "external":
        requested_filter(plant_options(options).filter, options.bench)
    node.box_fault = partial(box_mismatch, box)
    return box


def check_run(run: RunDirectory, settings: TrainingSettings, checkpoint: Checkpoint) -> None:
    """Raise ValueError, one sentence that names the file, unless the run can be resumed from its folder."""
    best = run.best / AGENT
    agents = {run.latest / AGENT: checkpoint.learner} | ({best: best.read_bytes()} if best.is_file() else {})
    for path, agent in agents.items():
        try:
            check_agent(agent, settings.sac)
        except ValueError as error:
            raise ValueError(f"{path} cannot be gone on from: {error}") from error
    if checkpoint.replay.shape[1] != sum(ReplayBuffer(OBSERVATIONS, ACTIONS, 65).widths):
        raise ValueError(f"{run.latest / 'replay.npy'} holds transitions of {checkpoint.replay.shape[1]} numbers")
    if not checkpoint.trainer:  # nothing had happened yet
        return
    try:
        Progress(**checkpoint.trainer["progress"])
        np.random.default_rng(0).bit_generator.state = checkpoint.trainer["random_state"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{run.latest / 'trainer.json'} is damaged: {error}") from error


def begin_checkpoint(run: RunDirectory, settings: TrainingSettings, start: InitialAgent | None) -> None:
    """Write the first checkpoint, of the initial agent, before anything moves."""
    agent = start.agent if start else dump(Sac(OBSERVATIONS, ACTIONS, settings.sac))
    nothing = ReplayBuffer(OBSERVATIONS, ACTIONS, settings.sac.batch_size + 128)
    write_run(SaveRequest(run.path, {}, best=False), agent, None, nothing, settings)


def restore_plant_file(run: RunDirectory, settings: TrainingSettings, options: argparse.Namespace) -> None:
    """Write the plant options again if the run's folder was deleted and a checkpoint has recreated it."""
    if run.latest.exists() and not run.load_plant():
        run.save_settings(settings, plant_options_as_yaml(options))


def wait_for_box(node: GraphNode) -> BoxIdentity:
    """Wait for the box of a plant that already runs; returns its identity.

    Raises KeyboardInterrupt: a signal arrived before there was one; CompanionError: the box was not described.
    """
    if not node.wait_for_plant() or node.box is None:
        raise KeyboardInterrupt
    box = BoxIdentity.of_box(node.box)
    node.box_fault = partial(box_mismatch, box)
    return box


def rebase_gains(settings: TrainingSettings, box: BoxIdentity, node: GraphNode) -> TrainingSettings:
    """Express the configuration's range of total gains relative to this box's base gains; explicit parameters win."""
    base, gains = box.base_gains or BASE, settings.task.gains
    shifted = unless_said(node, gains, gains.shifted(BASE[0] - base[0], BASE[1] - base[1]), "task.gains.")
    return replace(settings, task=replace(settings.task, gains=shifted))


def find_initial_agent(options: argparse.Namespace) -> InitialAgent | None:
    """Return the agent named by --from, else the one shipped for this configuration, if any."""
    if options.start is not None:
        return None if str(options.start) == SCRATCH else load_initial_agent(options.start)
    return shipped_agent(options.configuration)


def begin_record(node: GraphNode, prepared: Prepared, options: argparse.Namespace) -> RunRecord:
    """Open run.json and record the start of the run; overrides are recorded there as well."""
    record = RunRecord(prepared.run.record)

    def tell(sentence: str) -> None:
        node.say(sentence, warning=True)
        record.add("override", sentence)

    node.override = GainOverride(guard_range(prepared.settings.task.gains), tell, prepared.settings.base_gains)
    source = str(prepared.start.source) if prepared.start else None
    record.add("start", plant=options.plant, start=source, resumed=prepared.checkpoint is not None)
    words = shlex.split(options.filter)
    if options.plant != "external" and (sentence := protection_gap(prepared.settings.task.gains, words, options.bench)):
        node.say(sentence, warning=True)
        record.add("uncovered", sentence)
    return record


def start_plant(stack: ExitStack, options: argparse.Namespace, prepared: Prepared, node: GraphNode) -> Path | None:
    """Start the companions, which the node watches from now on; returns the folder of the recording."""
    run = prepared.run
    start_page(stack, node, wanted=options.dashboard, keep=node.announcer.keep)
    recording = _free(run.bag) if options.record and options.plant != "external" else None
    metadata = (f"run={run.path.name}", f"seed={prepared.settings.seed}")
    kept = {"metadata": metadata, "attachments": (run.config,), "policies": (run.policy,)}
    plant = plant_options(options, recording=recording, seed=prepared.settings.seed, **kept)
    companions = start_companions(stack, plant, prepared.settings.task.gains, run.path, node.announcer.keep)
    node.watch_companions(companions, recording)
    node.load_force = run.path / LOAD_FORCE if options.plant == "emulator" else None
    return recording


def _free(folder: Path) -> Path:
    """Return `folder`, or the first free of folder-2, folder-3 ...: a resumed run gets a separate recording."""
    candidates = (folder.with_name(f"{folder.name}-{n}") for n in range(2, 10_000))
    return folder if not folder.exists() else next(path for path in candidates if not path.exists())
