# SPDX-License-Identifier: Apache-2.0
"""A training from its first word to its last: prepare, train, evaluate; in the end the plant is disarmed."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack

import torch

from hydro_bridge.process.endings import undisturbed
from hydro_bridge.safety.readiness import Readiness
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.nodes.evaluate import evaluate_on
from hydro_policy.nodes.graph import GraphNode
from hydro_policy.nodes.options import rearms
from hydro_policy.nodes.progress import TrainingProgress
from hydro_policy.nodes.provenance import of_policy
from hydro_policy.nodes.results import conditions, show_results
from hydro_policy.nodes.trainer_results import compared, leave_page, tell_files, timing
from hydro_policy.nodes.trainer_start import (
    Prepared,
    begin_record,
    prepare,
    start_plant,
    taken_back,
    tell_plant_again,
)
from hydro_policy.runs.initial_agent import Start
from hydro_policy.runs.record import RunRecord
from hydro_policy.sessions.episode import Phase
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.supervision import requirements


def train(options: argparse.Namespace) -> int:
    """Prepare, train, evaluate; whatever happens: disarm, checkpoint, end the companions, in this order."""
    began = time.monotonic()
    torch.set_num_threads(1)
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("trainer")
        stack.callback(node.destroy_node)
        prepared = prepare(options, node)
        stack.enter_context(taken_back(prepared, node))
        run, settings = prepared.run, prepared.settings
        node.sayings.log = stack.enter_context(run.log.open("a", buffering=1, encoding="utf-8"))
        node.say(f"run {run.path}, episodes {settings.episodes}, plant {options.plant}")
        if run.policy.is_file():
            node.say(of_policy(run.policy))
        record = begin_record(node, prepared, options)
        learner = LearnerSupervisor(settings, run, prepared.checkpoint, prepared.agent)
        recording = start_plant(stack, options, prepared, node)
        session = begin_session(node, prepared, learner, record, rearm=rearms(options))
        stack.callback(tell_plant_again, run, settings, options)
        stack.callback(lambda: learner.stop(session.state()))
        stack.callback(node.disarm)
        stack.callback(quiet.enter_context, undisturbed())  # first of all: a second Ctrl-C, or a closed terminal, waits
        finished, results = drive(options, node, session, learner, prepared.start)
        if finished:  # a run that was stopped hands nothing over
            node.heir = options.hand_over or ""
        record.add("end", session.gave_up, **timing(node, session), complete=finished)
    notes = conditions(options, run=str(run.path), seed=settings.seed)  # once disarmed: it asks git
    if results is not None:
        show_results(results, run, notes)
    record.flush()
    leave_page(run, record, results, notes)
    tell_files(run, recording, finished, options, time.monotonic() - began)
    if session.gave_up:
        print(f"Training was given up: {session.gave_up}; {run.record} has what happened.", file=sys.stderr)
        return 1
    return 0 if finished else 130


def begin_session(
    node: GraphNode, prepared: Prepared, learner: LearnerSupervisor, record: RunRecord, *, rearm: bool
) -> TrainingSession:
    """The session of this run on the node, which from now on tells it what the filter says."""
    session = TrainingSession(
        prepared.settings,
        learner,
        node,
        rearm=rearm,
        state=(prepared.checkpoint.trainer or None) if prepared.checkpoint else None,
        best=prepared.best,
        override=node.override,
        record=record,
        requirements=node.requirements,
    )
    node.listen_to_corrections()
    node.tell_steps()
    return session


def drive(
    options: argparse.Namespace,
    node: GraphNode,
    session: TrainingSession,
    learner: LearnerSupervisor,
    start: Start | None,
) -> tuple[bool, EvaluationSession | None]:
    """Train, then evaluate if asked for: (whether all came to its end, the evaluation or None)."""
    if not rearms(options):
        node.listen_for_enter()
    if not node.meet():
        return False, None
    bar = TrainingProgress(node, session, learner)
    try:
        finished = session.state_of_run.trained or node.drive(session, bar.tick)
    finally:
        bar.close()
    inference = session.explorer.inference.sentence()
    node.say(f"gains at 100 Hz: jitter {node.timing.jitter.sentence()}; of which inference {inference}")
    if not finished or session.gave_up or not options.evaluate:
        return finished and not session.gave_up, None
    wait_for(learner, node)  # a finished run that was resumed: nobody has yet
    session.keeper.start()
    bar.phase = lambda: Phase.EVALUATING
    results = evaluate_on(node, compared(session, start), rearm=rearms(options), after=session.watch)
    if results.finished:
        node.heir = options.hand_over or ""
    node.disarm()  # now, not after the plots
    bar.phase = lambda: Phase.FINISHED
    bar.publish()
    return results.finished, results


def wait_for(learner: LearnerSupervisor, node: GraphNode) -> None:
    """Wait until the learner is ready, and not for ever.

    Raises
    ------
    NotReadyError
        It takes too long.
    """
    readiness = Readiness([requirements.learner(learner)], node.say)
    while not readiness.complete:
        if (sentence := learner.restart_if_dead()) is not None:
            node.say(sentence, warning=True)
        readiness.look(time.monotonic())
        time.sleep(0.05)
