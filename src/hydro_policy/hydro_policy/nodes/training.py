# SPDX-License-Identifier: Apache-2.0
"""Training run on a live plant: prepare (folder, settings, agent, companions), train, evaluate, write the results."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.ros.companion import start_dashboard
from hydro_bridge.ros.node import leave_graph, refuse_unknown_parameters
from hydro_bridge.safety.readiness import Readiness
from hydro_core.cli.console import writable_folder
from hydro_core.process.endings import signals_ignored
from hydro_core.size import rescale
from hydro_policy.evaluation import report as evaluation
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.gain_search import coarse_grid
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.learner_process.learner import write_run
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.nodes.evaluation import (
    box_mismatch,
    conditions,
    evaluate_on,
    expected_box,
    remove_rejected,
    require_matching_agent,
    require_same_box,
    search_on,
    show_results,
    training_provenance,
    write_page,
)
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.nodes.graph.progress import TrainingProgress
from hydro_policy.nodes.startup.companions import (
    LOAD_FORCE,
    describe_policy,
    guard_range,
    protection_gap,
    requested_filter,
    start_companions,
)
from hydro_policy.nodes.startup.options import (
    SCRATCH,
    declare_settings,
    load_cell,
    may_rearm,
    plant_options,
    plant_options_as_yaml,
    unless_said,
)
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs import report as training
from hydro_policy.runs.digest import circumstances, run_digest
from hydro_policy.runs.initial_agent import AGENT, InitialAgent, load_initial_agent, shipped_agent
from hydro_policy.runs.run import Checkpoint, RunDirectory, RunRecord, TrainingSettings, load_checkpoint
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.sac import ReplayBuffer, Sac, actor_parameters, dump, restore
from hydro_policy.sessions.episode import Phase
from hydro_policy.sessions.run_state import Progress
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.supervision import plant_supervisor
from hydro_policy.supervision.override import GainOverride
from hydro_policy.task.cases import EvaluationSettings
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
    if options.plant == "external":
        box = wait_for_box(node)
        require_matching_agent(start, box)
        if options.resume is None:
            size = settings.task.size
            settings = unless_said(node, settings, rescale(settings, size, box.size or size))
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
            restore(Sac(OBSERVATIONS, ACTIONS, settings.sac), agent)
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
    write_run(run, settings, agent, nothing, {})


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
    start_dashboard(stack, node, wanted=options.dashboard, keep=node.announcer.keep)
    recording = _free(run.bag) if options.record and options.plant != "external" else None
    metadata = (f"run={run.path.name}", f"seed={prepared.settings.seed}")
    kept = {"metadata": metadata, "attachments": (run.config,), "policies": (run.policy,)}
    plant = plant_options(options, recording=recording, seed=prepared.settings.seed, controller="trainer", **kept)
    companions = start_companions(stack, plant, prepared.settings.task.gains, run.path, node.announcer.keep)
    node.watch_companions(companions, recording)
    node.load_force = run.path / LOAD_FORCE if options.plant == "emulator" else None
    return recording


def _free(folder: Path) -> Path:
    """Return `folder`, or the first free of folder-2, folder-3 ...: a resumed run gets a separate recording."""
    candidates = (folder.with_name(f"{folder.name}-{n}") for n in range(2, 10_000))
    return folder if not folder.exists() else next(path for path in candidates if not path.exists())


def recordings(run: RunDirectory) -> list[Path]:
    """Return the recordings of a run, those of resumptions last."""
    later = sorted(run.path.glob(f"{run.bag.name}-*"), key=lambda folder: int(folder.name.rpartition("-")[2]))
    return [folder for folder in (run.bag, *later) if folder.exists()]


SEARCHED = EvaluationSettings(frequencies=(1.0, 2.0))
"""References of the search for the best fixed gains."""


def paper_controllers(session: TrainingSession, start: InitialAgent | None) -> list[Controller]:
    """Return the paper's controllers: I trained on the bench, II pretrained, III fixed; without II the base gains.

    I is the best policy of the run, or the last one if none was better than the initial one.
    """
    gains, best = session.settings.task.gains, session.run.best
    name = "I: last policy, trained here"
    if best is not None and trained_a_better_one(session):
        session.policy.load_flat(best)
        name = "I: policy, trained here"
    controllers: list[Controller] = [PolicyController(session.policy, gains, name)]
    if start is not None:
        before = Policy(start.sac, session.settings.task.size)
        before.load_flat(actor_parameters(start.agent))
        controllers.append(PolicyController(before, gains, "II: policy it started from"))
    base = session.settings.base_gains
    controllers.append(FixedGains(90.0, 15.0, base))
    return controllers if start is not None else [*controllers, FixedGains(15.0, 5.0, base)]


def gain_range(settings: TrainingSettings) -> str:
    """Return what the policy may choose, and that more is allowed where the range is the paper's."""
    gains, (kp, ki) = settings.task.gains, settings.base_gains
    told = f"the policy chooses K_p up to {kp + gains.delta_kp_max:g} and K_i up to {ki + gains.delta_ki_max:g}"
    paper = gains == configuration("paper", base=settings.base_gains).task.gains
    return f"{told}; --configuration wide tracks several times better, up to K_p 300" if paper else told


def trained_a_better_one(session: TrainingSession) -> bool:
    """Return whether a policy trained here scored better than the initial one, by more than noise."""
    return any(exam["best"] and exam["episode"] > 0 for exam in session.progress.exams)


def timing(node: GraphNode, session: TrainingSession) -> dict[str, float]:
    """Return percentiles [s] of the timings reported in results.md."""
    measured = {"jitter": node.timing.jitter, "inference": session.explorer.inference, "response": node.timing.response}
    return {f"{name}_p99": latency.percentile(99) for name, latency in measured.items()}


def write_training_page(
    run: RunDirectory, record: RunRecord, results: TrialRunner[Comparison] | None, notes: Mapping[str, Any]
) -> None:
    """Write learning.png and report.html into the run's folder; a failure is reported, never raised."""
    found = evaluation.sections(results, run.tracking_plot) if results is not None and results.scores else []
    try:
        training.draw_curve(record.events, run.learning_curve)
    except OSError as error:
        print(f"no learning curve: {error.strerror or error}", file=sys.stderr)
    told = training.sections(record.events, run.learning_curve)
    write_page(run, f"Training {run.path.name}", notes, found + told)


def print_files(
    run: RunDirectory, recording: Path | None, finished: bool, options: argparse.Namespace, seconds: float
) -> None:
    """Print where each file is and what to run next."""
    listed = [
        ("policy", run.policy),
        ("checkpoint", run.latest),
        ("best agent", run.best / AGENT),
        ("what happened", run.record),
        ("recording", recording),
        ("evaluation", run.evaluation),
        ("tracking plot", run.tracking_plot),
        ("page of the run", run.page),
        ("log", run.log),
    ]
    print(f"\n{'Done' if finished else 'Ended early'} after {seconds:.0f} s. Files:")
    for name, path in listed:
        if path is not None and path.exists():
            print(f"  {name:22s} {path}")
    plant = f"--plant {options.plant}" + (f" --port {options.port}" if options.port else "")
    print("Next:")
    if not finished and run.latest.exists():
        print(f"  go on            ros2 run hydro_policy trainer {plant} --resume {run.path}")
    print(f"  full training    ros2 run hydro_policy trainer {plant} --resume {run.path} --episodes 160 --evaluate")
    print(f"  compare again    ros2 run hydro_policy evaluate {plant} --policy {run.path} --fixed 90 15 --fixed 15 5")


def say_policy(node: GraphNode, path: Path, *, resumed: bool) -> None:
    """Report which policy is in the run's folder; a damaged one is only reported, since checkpoints hold the agent."""
    if not path.is_file():
        return
    try:
        node.say(("the best so far: " if resumed else "") + describe_policy(path))
    except ValueError as error:
        node.warn(f"{error}; the run goes on from its checkpoint, and the file is rewritten with the next best policy")


def train(options: argparse.Namespace) -> int:
    """Prepare, train, evaluate. In any case: disarm, write a checkpoint, stop the companions, in this order."""
    began = time.monotonic()
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("trainer")
        stack.callback(leave_graph, node)
        prepared = prepare(options, node)
        stack.enter_context(remove_rejected(prepared.run, node, made=prepared.made))
        run, settings = prepared.run, prepared.settings
        node.announcer.log = stack.enter_context(run.log.open("a", buffering=1, encoding="utf-8"))
        node.say(f"run {run.path}, episodes {settings.episodes}, plant {options.plant}")
        node.say(gain_range(settings))
        say_policy(node, run.policy, resumed=options.resume is not None)
        record = begin_record(node, prepared, options)
        agent = prepared.start.agent if prepared.start else None
        real_time = options.plant == "external" or plant_options(options).real_time
        learner = LearnerSupervisor(settings, run, prepared.checkpoint, agent, real_time=real_time)
        recording = start_plant(stack, options, prepared, node)
        session = begin_session(node, prepared, learner, record, rearm=may_rearm(options))
        stack.callback(lambda: learner.stop(session.state()))
        stack.callback(node.disarm)
        stack.callback(
            quiet.enter_context, signals_ignored()
        )  # first of all: a second Ctrl-C, or a closed terminal, waits
        finished, results = drive(options, node, session, learner, prepared.start)
        if finished:  # a stopped run hands nothing over
            node.successor = options.hand_over or ""
        record.add("end", session.run.gave_up, **timing(node, session), complete=finished)
    notes = conditions(options, run=str(run.path), seed=settings.seed)  # once disarmed: it asks git
    if results is not None:
        show_results(results, run, notes)
    digest = (
        run_digest(run.policy, recordings(run), results.scores if results else ()) if finished and node.paced else ""
    )
    if digest:
        record.add("digest", run_digest=digest, circumstances=circumstances())
    record.flush()
    write_training_page(run, record, results, notes)
    print_files(run, recording, finished, options, time.monotonic() - began)
    if digest:
        print(f"\nThe same seed gives the same digest {circumstances()}:\nrun digest: {digest}")
    if session.run.gave_up:
        print(f"Training was given up: {session.run.gave_up}; {run.record} has what happened.", file=sys.stderr)
        return 1
    return 0 if finished else 130


def begin_session(
    node: GraphNode, prepared: Prepared, learner: LearnerSupervisor, record: RunRecord, *, rearm: bool
) -> TrainingSession:
    """Create the session of this run and connect it to the filter's corrections."""
    session = TrainingSession(
        prepared.settings,
        learner,
        node.supervisor(plant_supervisor.learner(lambda: learner.ready), rearm=rearm),
        state=(prepared.checkpoint.trainer or None) if prepared.checkpoint else None,
        best=prepared.best,
        record=record,
    )
    node.listen_to_corrections()
    node.tell_steps()
    return session


LEFT_OUT = (
    "best fixed gains and compensated law are not compared, since a person would have to arm the plant for them: "
    "`evaluate --grid` does that"
)


def drive(
    options: argparse.Namespace,
    node: GraphNode,
    session: TrainingSession,
    learner: LearnerSupervisor,
    start: InitialAgent | None,
) -> tuple[bool, TrialRunner[Comparison] | None]:
    """Train, then evaluate if requested; returns whether all was completed, and the evaluation or None."""
    if not may_rearm(options):
        node.listen_for_enter()
    if not node.wait_for_plant():
        return False, None
    bar = TrainingProgress(node, session, learner)
    try:
        finished = session.run.trained or node.run_session(session, bar.tick)
    finally:
        bar.close()
    inference = session.explorer.inference.sentence()
    node.say(f"gains at 100 Hz: jitter {node.timing.jitter.sentence()}; inference took {inference}")
    if session.progress.exams and not trained_a_better_one(session):
        node.say(training.NONE_BETTER)
    if not finished or session.run.gave_up or not options.evaluate:
        return finished and not session.run.gave_up, None
    wait_for(learner, node)  # a finished run that was resumed: not done yet
    session.run.start()
    bar.phase = lambda: Phase.EVALUATING
    controllers = paper_controllers(session, start)
    rearm = may_rearm(options)
    watch = node.supervisor(rearm=rearm, after=session.watch)
    if rearm:
        grid = coarse_grid(session.settings.task.gains, session.settings.base_gains)
        search = search_on(node, grid, replace(SEARCHED, amplitude=node.size.force), watch)
        if search.trial is not None:
            return False, None
        controllers += [search.best] if search.search.found else []
        watch = node.supervisor(rearm=rearm, after=watch)
    else:
        node.say(LEFT_OUT)
    law, cell = node.law if rearm else None, load_cell(options)
    results = evaluate_on(node, controllers, watch, law=law, cell=cell, learned=cell is None)
    if results.finished:
        node.successor = options.hand_over or ""
    node.disarm()  # now, not after the plots
    bar.phase = lambda: Phase.FINISHED
    bar.publish()
    return results.finished, results


def wait_for(learner: LearnerSupervisor, node: GraphNode) -> None:
    """Wait for the learner to be ready, with a time-out. Raises NotReadyError: it takes too long."""
    readiness = Readiness([plant_supervisor.learner(lambda: learner.ready)], node.say)
    while not readiness.complete:
        if (sentence := learner.restart_if_dead()) is not None:
            node.say(sentence, warning=True)
        readiness.look(time.monotonic())
        time.sleep(0.05)
