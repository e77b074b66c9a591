# SPDX-License-Identifier: Apache-2.0
"""Evaluation on a live plant: start it, search fixed gains if requested, run all controllers, show the results."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from hydro_bridge.process.endings import undisturbed
from hydro_bridge.ros.companion import start_page
from hydro_bridge.ros.node import declare_parameters, refuse_unknown_parameters
from hydro_bridge.safety.guard import NOT_OFFERED
from hydro_bridge.safety.readiness import NotReadyError
from hydro_bridge.serial.frames import BoxLaw
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import Compensated, Controller, policy_file
from hydro_policy.evaluation.gain_search import GridSession, GridSettings
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings
from hydro_policy.nodes.evaluation.options import evaluation_settings, make_controllers, required_gain_range
from hydro_policy.nodes.evaluation.results import (
    conditions,
    new_evaluation,
    remove_rejected_evaluation,
    show_results,
    write_page,
)
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.nodes.graph.progress import EvaluationProgress
from hydro_policy.nodes.startup.box_expectation import box_mismatch, expected_box
from hydro_policy.nodes.startup.companions import LOAD_FORCE, start_companions
from hydro_policy.nodes.startup.guard_range import guard_range, protection_gap
from hydro_policy.nodes.startup.options import load_cell, may_rearm, plant_options
from hydro_policy.nodes.startup.provenance import describe_policy
from hydro_policy.runs.run import RunDirectory
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task.mdp import BASE, GainRange
from hydro_sim.files.pairing import BoxIdentity


def evaluate(options: argparse.Namespace) -> int:
    """Run the evaluation of the command line; returns the exit status."""
    make_controllers(options, expected_box(options))  # invalid input is refused before anything is created
    load_cell(options)
    evaluation_settings(options)
    with new_evaluation(Path(options.runs), options.name) as run:
        return evaluate_in(run, options)


def evaluate_in(run: RunDirectory, options: argparse.Namespace) -> int:
    """Run the evaluation with its results in `run`; returns the exit status."""
    box = expected_box(options)
    settings = evaluation_settings(options)
    grid = GridSettings(kp_max=options.kp_max) if options.grid else None
    wanted = guard_range(required_gain_range(make_controllers(options, box), grid, box.base_gains))
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("evaluate")
        stack.callback(node.destroy_node)
        settings = declare_parameters(node, settings)
        refuse_unknown_parameters(node)
        stack.enter_context(remove_rejected_evaluation(run, node))
        if options.plant != "external":
            start_plant(stack, node, options, box, wanted, run)
        stack.callback(node.disarm)
        stack.callback(quiet.enter_context, undisturbed())
        if not node.wait_for_plant(law=options.law != "paper") or node.box is None:
            return 130
        if options.plant == "external":  # only now it is known whether the graph has a page
            start_page(stack, node, wanted=options.dashboard, keep=node.announcer.keep)
        if options.law != "paper" and node.law is None:
            if options.law == "compensated" or options.load_cell:
                raise NotReadyError(NOT_OFFERED)
            node.say(f"{NOT_OFFERED}; the paper's law alone is compared")
        box = BoxIdentity.of_box(node.box)
        controllers = make_controllers(options, box)
        node.box_fault = partial(box_mismatch, box)
        node.override = GainOverride(
            guard_range(required_gain_range(controllers, grid, box.base_gains)),
            node.override.say,
            box.base_gains or BASE,
        )
        for path in options.policy:
            node.say(describe_policy(policy_file(path)))
        if not may_rearm(options):
            node.listen_for_enter()
        before: GridSession | None = None
        if grid is not None:
            before = search_on(node, grid, settings, rearm=may_rearm(options))
            if not before.finished:
                return 130
            if before.search.found:
                controllers.append(before.best)
        results = evaluate_on(
            node, controllers, rearm=may_rearm(options), settings=settings, after=before.watch if before else None,
            law=None if options.law == "paper" else node.law, cell=load_cell(options),
        )  # fmt: skip
        if results.finished:  # a stopped session hands nothing over
            node.successor = options.hand_over or ""
    notes = conditions(options, box=box.told, integral=box.integral or "not told")
    if options.plant in ("sim", "emulator"):
        notes["seed"] = options.seed
    json, plot = (Path(name) if name else None for name in (options.json, options.plot))
    show_results(results, run, notes, json=json, plot=plot)
    if results.scores:
        write_page(run, f"Evaluation {run.path.name}", notes, report.sections(results, run.tracking_plot))
        print(f"page: {run.page}", file=sys.stderr)
    return 0 if results.finished else 130


def start_plant(
    stack: ExitStack,
    node: GraphNode,
    options: argparse.Namespace,
    box: BoxIdentity,
    wanted: GainRange,
    run: RunDirectory,
) -> None:
    """Start the plant and its companions; raises PairingError before anything runs if the filter does not fit."""
    start_page(stack, node, wanted=options.dashboard, keep=node.announcer.keep)
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="hydro-")))
    policies = tuple(map(policy_file, options.policy))
    recording = Path(options.record) if options.record else run.bag if options.recorded else None
    plant = plant_options(options, recording=recording, seed=options.seed, policies=policies)
    if sentence := protection_gap(wanted, plant.filter, plant.bench):
        node.say(sentence, warning=True)
    node.box_fault = partial(box_mismatch, box)
    node.watch_companions(start_companions(stack, plant, wanted, folder, node.announcer.keep), recording)
    node.load_force = folder / LOAD_FORCE if options.plant == "emulator" else None


def search_on(
    node: GraphNode,
    grid: GridSettings,
    settings: EvaluationSettings,
    *,
    rearm: bool,
    after: PlantSupervisor | None = None,
) -> GridSession:
    """Search the best fixed gains on the plant by short runs; not `finished` after a signal.

    `after` is the watch of the previous session, if there was one.
    """
    short = replace(settings, settle=1.0, measure=2.0, periods=1, repeats=1)
    session = GridSession(
        grid, short, node, rearm=rearm, after=after, override=node.override, requirements=node.requirements
    )
    told = 0

    def tick() -> None:
        nonlocal told
        for pair, rmse in list(session.search.tried.items())[told:]:
            cells = " ".join(f"{value:.1f}" for value in rmse)
            node.say(f"grid ({pair[0]:g}, {pair[1]:g}): RMSE {cells} N")
            told += 1

    node.run_session(session, tick)
    tick()
    if session.finished and not session.search.found:
        node.say("the grid found no gains: even the lowest were stopped (above)", warning=True)
    if session.search.tried:
        print(f"\n{report.grid_table(session.search, short).text()}")
    return session


def evaluate_on(
    node: GraphNode,
    controllers: Sequence[Controller],
    *,
    rearm: bool,
    settings: EvaluationSettings | None = None,
    after: PlantSupervisor | None = None,
    law: BoxLaw | None = None,
    cell: LoadCell | None = None,
) -> EvaluationSession:
    """Run an evaluation on a running node; after a signal the results so far are returned.

    `after` is the watch of the previous session, if there was one; with `law`, the box's compensated law is compared,
    too; with `cell`, for the force in front of that.
    """
    compensation = None if law is None else LiveCompensation(law, cell=cell)
    if compensation is not None:
        node.compensate(compensation)
        controllers = [*controllers, Compensated(compensation, node.override.base)]
    session = EvaluationSession(
        settings or EvaluationSettings(),
        controllers,
        node,
        rearm=rearm,
        after=after,
        override=node.override,
        requirements=node.requirements,
        compensation=compensation,
        felt=node.load_force,
    )
    bar = EvaluationProgress(session)
    try:
        node.run_session(session, bar.tick)
    finally:
        bar.close()
    return session
