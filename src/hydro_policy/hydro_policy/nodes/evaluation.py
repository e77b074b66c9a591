# SPDX-License-Identifier: Apache-2.0
"""Evaluation on a live plant: start it, search fixed gains if requested, run all controllers, write the results.

Each trial is recorded in run.json of the evaluation's folder; a resumed evaluation runs the missing ones.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hydro_bridge.bags.writer import code_version
from hydro_bridge.pages import Section
from hydro_bridge.ros.companion import CompanionError, start_dashboard
from hydro_bridge.ros.node import declare_parameters, leave_graph, refuse_unknown_parameters
from hydro_bridge.safety.guard import LAW_NOT_OFFERED_MESSAGE
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.bench_scales import rescale
from hydro_core.cli.console import UserError
from hydro_core.files.atomic import encode_json
from hydro_policy.compensation.estimator import CompensatorSettings, LoadCell
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.compensation.residual import Network
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import Compensated, Controller, FixedGains, policy_controller, policy_file
from hydro_policy.evaluation.gain_search import GridPlan, GridSettings
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.nodes.graph_node import CleanupStack, GraphNode
from hydro_policy.nodes.parameters import keep_overridden
from hydro_policy.nodes.plant_options import (
    NO_FILTER_WORDS,
    box_mismatch,
    expected_box,
    load_cell,
    may_rearm,
    plant_options,
    require_matching_policy,
)
from hydro_policy.nodes.plants import describe_policy, guard_range, start_plant
from hydro_policy.nodes.progress import TrialProgress
from hydro_policy.runs.report import write_page
from hydro_policy.runs.run_directory import RunDirectory, RunRecord
from hydro_policy.supervision.monitor import MonitorSettings, SafetyMonitor
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor, corrections_requirement
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import BASE_GAINS, GainRange
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.model.bench import NOMINAL


def make_controllers(options: argparse.Namespace, box: BoxIdentity) -> list[Controller]:
    """Create the controllers named on the command line, for this box."""
    for path in options.policy:
        require_matching_policy(path, box)
    controllers: list[Controller] = [policy_controller(path) for path in options.policy]
    gains = options.fixed or ([] if options.law == "compensated" else [(90.0, 15.0), (15.0, 5.0)])
    return controllers + [FixedGains(kp, ki, box.base_gains or BASE_GAINS) for kp, ki in gains]


def required_gain_range(
    controllers: Sequence[Controller], grid: GridSettings | None = None, base: tuple[float, float] | None = None
) -> GainRange:
    """Return the range of gain changes that the guard must pass for controllers and grid, on a box with base gains."""
    base = base or BASE_GAINS
    ranges = [controller.gain_range for controller in controllers] or [FixedGains(*base, base).gain_range]
    if grid is not None:
        corners = ((grid.kp_min, grid.ki_min), (grid.kp_max, grid.ki_max))
        ranges += [FixedGains(*pair, base).gain_range for pair in corners]
    return GainRange.enclosing(*ranges)


@contextmanager
def evaluation_folder(options: argparse.Namespace) -> Iterator[RunDirectory]:
    """Create runs/NAME, by default evaluate- with date and time, and remove it if it stays empty; or resume one."""
    parent = Path(options.runs)
    run = RunDirectory(options.resume or parent / (options.name or f"evaluate-{datetime.now():%Y%m%d-%H%M%S}"))
    first = not options.resume and not parent.exists()
    if options.resume and not run.record.is_file():
        raise UserError(f"{run.path} holds no evaluation to resume: there is no {run.record.name}")
    if not options.resume:
        run.path.mkdir(parents=True)
    before = run.recordings
    try:
        yield run
    finally:
        for bag in run.recordings[len(before) :]:
            print(f"recording: {bag}", file=sys.stderr)
        for folder in (run.path, parent) if first else (run.path,):
            with suppress(OSError):  # not empty, or gone already
                folder.rmdir()


@contextmanager
def remove_rejected(run: RunDirectory, node: GraphNode, *, made: bool = True) -> Iterator[None]:
    """Remove the folder of a run, if it is new (`made`), after a companion process has rejected its input."""
    try:
        yield
    except CompanionError:
        lost = (
            node.companions.lost and not node.companions.refused
        )  # ended by itself: there is a recording, or it can be resumed
        if made and not lost and node.timing.response.count == 0:  # no gains have ever gone out
            shutil.rmtree(run.path, ignore_errors=True)
        raise


def conditions(options: argparse.Namespace, **more: Any) -> dict[str, Any]:
    """Return the conditions of a measurement: plant, filter and bench of the command line, code version."""
    told: dict[str, Any] = {"plant": options.plant}
    if options.plant != "external":  # else those of the running graph
        told |= {"filter": options.filter or "the default one", "bench": str(options.bench or "the nominal one")}
    if options.plant == "emulator":
        told |= {"truth": str(options.truth or "the default one"), "faults of the line": options.faults or "none"}
    if options.load_cell:
        told["load cell"] = str(options.load_cell)
    if options.base_gains:
        told["base gains"] = "{:g} {:g}".format(*options.base_gains)
    return {**told, **more, "code_version": code_version()}


def report_results(
    results: TrialRunner[Comparison], run: RunDirectory, notes: Mapping[str, Any], json: Path | None = None
) -> list[Section]:
    """Print the table, write figures (also to `json`) and plot into the run's folder; returns sections of its page."""
    if not results.scores:
        return []
    under = ", ".join(f"{name} {value}" for name, value in notes.items())
    print("\n".join(filter(None, ("", report.table(results).text(), report.best(results), under))))
    for file in filter(None, (run.evaluation, json)):
        report.write_json(results, file, notes)
    report.plot(results, run.tracking_plot)
    for name, file in {"figures of every run": json or run.evaluation, "plot": run.tracking_plot}.items():
        if file.is_file():
            print(f"{name}: {file}", file=sys.stderr)
    return report.sections(results, run.tracking_plot)


def evaluate(options: argparse.Namespace) -> int:
    """Run the evaluation of the command line; returns the exit status."""
    make_controllers(options, expected_box(options))  # invalid input is refused before anything is created
    given = {name: getattr(options, name) for name in ("repeats", "multisine", "steps", "fast")}
    given["recorded"] = tuple(map(str, options.recorded))
    given["frequencies"] = options.frequencies and tuple(options.frequencies)
    settings = EvaluationSettings(**{key: value for key, value in given.items() if value is not None})
    if load_cell(options) and options.learned_residual:
        raise UserError("--learned-residual does not know --load-cell: give one of them")
    if options.law == "paper" and options.learned_residual:
        raise UserError("--learned-residual is part of the compensated law: leave out --law paper")
    filtered = options.law != "compensated" or options.fixed or options.policy or options.grid
    if options.filter.split() == list(NO_FILTER_WORDS) and filtered:
        raise UserError("--filter none leaves the compensated law: say --law compensated and no other controller")
    with evaluation_folder(options) as run:
        return evaluate_in(run, options, settings)


def evaluate_in(run: RunDirectory, options: argparse.Namespace, settings: EvaluationSettings) -> int:
    """Run the evaluation with its results in `run`; returns the exit status."""
    box, cell, unfiltered = expected_box(options), load_cell(options), options.filter.split() == list(NO_FILTER_WORDS)
    controllers, rearm = make_controllers(options, box), may_rearm(options)
    grid = GridSettings(kp_max=options.kp_max) if options.grid else None
    with CleanupStack() as stack:
        node = GraphNode("evaluate")
        stack.callback(leave_graph, node)
        settings = declare_parameters(node, settings)
        refuse_unknown_parameters(node)
        stack.enter_context(remove_rejected(run, node, made=not options.resume))
        node.box_fault = partial(box_mismatch, box)
        if options.plant != "external":
            recording = run.next_recording if options.keeps_bag else None
            plant = plant_options(
                options, recording=recording, seed=options.seed, policies=tuple(map(policy_file, options.policy)),
                controller="evaluate",
            )  # fmt: skip
            wanted = guard_range(required_gain_range(controllers, grid, box.base_gains))
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="hydro-")))
            start_plant(stack, node, plant, wanted, run.path, folder, page=options.dashboard)
            if options.law == "compensated" and not unfiltered:
                # the plant's flags tell nothing of the filter under a law that needs none
                node.requirements.append(corrections_requirement(lambda: node.corrected))
        stack.callback(node.disarm)
        if not node.wait_for_plant(law=options.law != "paper") or node.box is None:
            return 130
        if options.plant == "external":  # only now it is known whether the graph has a page
            start_dashboard(stack, node, wanted=options.dashboard, log=node.announcer.write_log)
        if options.law != "paper" and node.law is None:
            if options.law == "compensated" or cell:
                raise NotReadyError(LAW_NOT_OFFERED_MESSAGE)
            node.report(f"{LAW_NOT_OFFERED_MESSAGE}; the paper's law alone is compared")
        box = BoxIdentity.of_box(node.box)
        settings = keep_overridden(node, settings, rescale(settings, NOMINAL, node.size))
        controllers = make_controllers(options, box)
        node.box_fault = partial(box_mismatch, box)
        gain_range = guard_range(required_gain_range(controllers, grid, box.base_gains))
        node.override = GainOverride(gain_range, node.override.report, box.base_gains or BASE_GAINS)
        policies = [describe_policy(policy_file(path)) for path in options.policy]
        for sentence in policies:
            node.report(sentence)
        about = {"settings": asdict(settings), "box": box.digest, "policies": policies, "grid": grid and asdict(grid)}
        record = start_record(run, {**about, "load_cell": cell and asdict(cell)})
        if not rearm:
            node.listen_for_enter()
        if not unfiltered:  # one that runs all the same may be of the bench as it was
            node.listen_to_corrections()  # whose status tells a filter that does not fit from one that does not answer
        results = compare_on(
            node, controllers, node.supervisor(rearm=rearm), settings=settings, grid=grid, rearm=rearm,
            compensated=options.law != "paper", cell=cell, learned=options.learned_residual, record=record,
        )  # fmt: skip
        if results is None:
            return 130
        record.add("end", complete=results.finished)
    record.flush()
    notes = conditions(options, box=box.description, integral=box.integral or "not told")
    if options.plant in ("sim", "emulator"):
        notes["seed"] = options.seed
    if page := report_results(results, run, notes, Path(options.json) if options.json else None):
        write_page(run, f"Evaluation {run.path.name}", notes, page)
        print(f"page: {run.page}", file=sys.stderr)
    if not results.finished and results.scores:
        print(f"go on with the same options and --resume {run.path}", file=sys.stderr)
    return 0 if results.finished else 130


def start_record(run: RunDirectory, about: Mapping[str, Any]) -> RunRecord:
    """Return the record of an evaluation; raises UserError if its first event describes another comparison."""
    record = RunRecord(run.record)
    known = json.loads(encode_json(about))
    if record.events and any(record.events[0].get(key) != value for key, value in known.items()):
        raise UserError(f"{run.path} compared something else: resume it with its own options")
    record.add("start", **known)
    return record


def compare_on(
    node: GraphNode, controllers: Sequence[Controller], supervisor: PlantSupervisor, *, settings: EvaluationSettings,
    grid: GridSettings | None = None, searched: EvaluationSettings | None = None, rearm: bool = False,
    compensated: bool = True, cell: LoadCell | None = None, learned: bool = False, record: RunRecord | None = None,
) -> TrialRunner[Comparison] | None:  # fmt: skip
    """Run a comparison on a running node; returns its runner, unfinished after a signal, None if that ended the search.

    `grid`, `searched`: grid search for the best fixed gains, which are then compared, and its references (default:
    `settings`). `rearm`: whether the plant may be armed without a person after that search. `compensated`: whether the
    box's compensated law is compared, if it has one. `cell`: load cell whose input force follows the reference under
    that law. `learned`: whether it is also run with the learned residual, unless there is a `cell`. `record`: record of
    the trials, of which earlier ones are reused.
    """
    controllers = list(controllers)
    if grid is not None:
        search = search_on(node, grid, searched or settings, supervisor, record or RunRecord())
        if search.trial is not None:
            return None
        controllers += [search.best] if search.search.any_completed else []
        supervisor = node.supervisor(rearm=rearm, after=supervisor)
    if compensated and node.law is not None and node.compensation is None:
        estimator = rescale(CompensatorSettings(), NOMINAL, node.size)
        node.compensate(LiveCompensation(node.law, estimator, cell, Network.load()))
    compensation = node.compensation if compensated else None
    if compensation is not None:
        controllers.append(Compensated(compensation, node.override.base))
        if learned and cell is None:
            controllers.append(Compensated(compensation, node.override.base, learned=True))
    plan = Comparison(settings, controllers)
    session = TrialRunner(
        plan, supervisor, compensation=compensation, load_force_file=node.load_force_file, record=record
    )
    with closing(TrialProgress(session, "evaluating")) as bar:
        node.run_session(session, bar.tick)
    return session


def search_on(
    node: GraphNode, grid: GridSettings, settings: EvaluationSettings, supervisor: PlantSupervisor, record: RunRecord
) -> GridPlan:
    """Search the best fixed gains on the plant by short trials; returns the plan, unfinished after a signal."""
    short = replace(settings, settle=1.0, measure=2.0, periods=1, repeats=1)
    plan = GridPlan(grid, short, node.override.base)
    monitor = SafetyMonitor(rescale(MonitorSettings(), NOMINAL, node.size))
    runner = TrialRunner(plan, supervisor, monitor=monitor, record=record, kind="grid")
    told = 0

    def tick() -> None:
        nonlocal told
        bar.tick()
        for pair, rmse in list(plan.search.results.items())[told:]:
            cells = " ".join(f"{value:.1f}" for value in rmse)
            node.report(f"grid ({pair[0]:g}, {pair[1]:g}): RMSE {cells} N")
            told += 1

    with closing(TrialProgress(runner, "searching fixed gains")) as bar:
        node.run_session(runner, tick)
        tick()
    if runner.finished and not plan.search.any_completed:
        node.report("the grid found no gains: even the lowest were stopped", warning=True)
    if plan.search.results:
        print(f"\n{report.grid_table(plan.search, short).text()}")
    return plan
