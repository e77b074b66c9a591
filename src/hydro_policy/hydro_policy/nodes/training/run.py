# SPDX-License-Identifier: Apache-2.0
"""Training run: prepare, train, evaluate, disarm, write the results."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from hydro_bridge.process.endings import undisturbed
from hydro_bridge.safety.readiness import Readiness
from hydro_policy.evaluation import report as evaluation
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.gain_search import coarse_grid
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.nodes.evaluation import (
    conditions,
    evaluate_on,
    remove_rejected,
    search_on,
    show_results,
    write_page,
)
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.nodes.graph.progress import TrainingProgress
from hydro_policy.nodes.startup.companions import describe_policy
from hydro_policy.nodes.startup.options import load_cell, may_rearm
from hydro_policy.nodes.training.start import (
    Prepared,
    begin_record,
    prepare,
    restore_plant_file,
    start_plant,
)
from hydro_policy.pretraining.configurations import configuration_of
from hydro_policy.runs import report as training
from hydro_policy.runs.initial_agent import AGENT, InitialAgent
from hydro_policy.runs.run import RunDirectory, RunRecord, TrainingSettings
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.sessions.episode import Phase
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.supervision import plant_supervisor
from hydro_policy.task.cases import EvaluationSettings

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
    paper = configuration_of(settings) == "paper"
    return f"{told}; --configuration wide tracks several times better, up to K_p 300" if paper else told


def trained_a_better_one(session: TrainingSession) -> bool:
    """Return whether a policy trained here scored better than the initial one, by more than noise."""
    return any(exam["best"] and exam["episode"] > 0 for exam in session.progress.exams)


def timing(node: GraphNode, session: TrainingSession) -> dict[str, float]:
    """Return percentiles [s] of the timings reported in results.md."""
    measured = {"jitter": node.timing.jitter, "inference": session.explorer.inference, "response": node.timing.response}
    return {f"{name}_p99": latency.percentile(99) for name, latency in measured.items()}


def write_training_page(
    run: RunDirectory, record: RunRecord, results: EvaluationSession | None, notes: Mapping[str, Any]
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
    torch.set_num_threads(1)
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("trainer")
        stack.callback(node.destroy_node)
        prepared = prepare(options, node)
        stack.enter_context(remove_rejected(prepared.run, node, made=prepared.made))
        run, settings = prepared.run, prepared.settings
        node.announcer.log = stack.enter_context(run.log.open("a", buffering=1, encoding="utf-8"))
        node.say(f"run {run.path}, episodes {settings.episodes}, plant {options.plant}")
        node.say(gain_range(settings))
        say_policy(node, run.policy, resumed=options.resume is not None)
        record = begin_record(node, prepared, options)
        agent = prepared.start.agent if prepared.start else None
        learner = LearnerSupervisor(settings, run, prepared.checkpoint, agent)
        recording = start_plant(stack, options, prepared, node)
        session = begin_session(node, prepared, learner, record, rearm=may_rearm(options))
        stack.callback(restore_plant_file, run, settings, options)
        stack.callback(lambda: learner.stop(session.state()))
        stack.callback(node.disarm)
        stack.callback(quiet.enter_context, undisturbed())  # first of all: a second Ctrl-C, or a closed terminal, waits
        finished, results = drive(options, node, session, learner, prepared.start)
        if finished:  # a stopped run hands nothing over
            node.successor = options.hand_over or ""
        record.add("end", session.run.gave_up, **timing(node, session), complete=finished)
    notes = conditions(options, run=str(run.path), seed=settings.seed)  # once disarmed: it asks git
    if results is not None:
        show_results(results, run, notes)
    record.flush()
    write_training_page(run, record, results, notes)
    print_files(run, recording, finished, options, time.monotonic() - began)
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
) -> tuple[bool, EvaluationSession | None]:
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
        if not search.finished:
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
