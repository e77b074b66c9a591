# SPDX-License-Identifier: Apache-2.0
"""Force RMSE of policies and fixed gains on sines of 300 N and more, on whichever plant publishes /hydro/state.

ros2 run hydro_policy evaluate --plant emulator --policy runs/NAME --fixed 90 15 --fixed 15 5
ros2 run hydro_policy evaluate --plant emulator --policy runs/NAME --fixed 90 15 --grid --multisine --steps --repeats 5
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import rclpy

from hydro_bridge.cli.console import command, writable, writable_folder
from hydro_bridge.process.endings import undisturbed
from hydro_bridge.ros import (
    CompanionError,
    declare_parameters,
    refuse_unknown_parameters,
    ros_arguments,
    start_page,
    start_ros,
)
from hydro_bridge.safety.readiness import NotReadyError
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller, policy_file
from hydro_policy.evaluation.gain_search import GridSession, GridSettings
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings
from hydro_policy.nodes.companions import start_companions
from hydro_policy.nodes.graph import GraphNode
from hydro_policy.nodes.guarding import guard_range, uncovered
from hydro_policy.nodes.options import add_plant_options, plant_options, rearms
from hydro_policy.nodes.planned import planned, refuse_policy, surprise
from hydro_policy.nodes.progress import EvaluationProgress
from hydro_policy.nodes.provenance import of_policy
from hydro_policy.nodes.results import conditions, new_evaluation, show_results, taken_back, write_page
from hydro_policy.runs.run import RunDirectory
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task.mdp import BASE, GainRange
from hydro_sim.files.pairing import Believed


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="evaluate", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_plant_options(result)
    what = result.add_argument_group("what")
    what.add_argument(
        "--policy",
        type=Path,
        action="append",
        default=[],
        metavar="RUN|FILE",
        help="a run's folder or a policy.safetensors",
    )
    what.add_argument(
        "--fixed",
        type=float,
        nargs=2,
        action="append",
        metavar=("KP", "KI"),
        help="fixed gains (default: 90 15 and 15 5)",
    )
    what.add_argument(
        "--grid",
        action="store_true",
        help="find the best fixed gains on the plant first, coarse to fine, and compare them, too",
    )
    what.add_argument("--kp-max", type=float, default=300.0, metavar="KP", help="of the grid (default 300)")
    what.add_argument("--multisine", action="store_true", help="a multisine, too")
    what.add_argument("--steps", action="store_true", help="smooth steps, too")
    what.add_argument("--settle", type=float, metavar="S", help="s left out at the start of each run (default 2)")
    what.add_argument("--periods", type=int, metavar="N", help="periods measured at least, and 3 s (default 1)")
    what.add_argument("--frequencies", type=float, nargs="+", metavar="HZ", help="default: 0.5 1 1.5 2")
    what.add_argument("--repeats", type=int, metavar="N", help="runs of each at each frequency (default 1)")
    what.add_argument("--seed", type=int, default=0, metavar="N", help="of the noise of simulation or emulator")
    files = result.add_argument_group("files")
    files.add_argument(
        "--runs", type=writable_folder, default="runs", metavar="DIR", help="folder of all runs (default: runs)"
    )
    files.add_argument("--name", help="of this one's folder: figures, plot, page, recording (default: date and time)")
    files.add_argument("--json", type=writable, metavar="FILE", help="write every run's figures to FILE, too")
    files.add_argument("--plot", type=writable, metavar="FILE", help="draw the fastest sine to FILE, too")
    files.add_argument("--record", type=writable_folder, metavar="DIR", help="record there instead (companions only)")
    files.add_argument("--no-record", dest="recorded", action="store_false", help="make no recording")
    return result


@command(ValueError, FileExistsError, CompanionError, NotReadyError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    start_ros(ros)
    try:
        return evaluate(options)
    finally:
        rclpy.try_shutdown()


def evaluate(options: argparse.Namespace) -> int:
    """Start what is asked for, run the plan, show the results."""
    compared(options, planned(options))  # what cannot be used is refused before anything is made
    evaluation_settings(options)
    with new_evaluation(Path(options.runs), options.name) as run:
        return evaluate_in(run, options)


def evaluate_in(run: RunDirectory, options: argparse.Namespace) -> int:
    """The evaluation in its folder."""
    box = planned(options)
    settings = evaluation_settings(options)
    grid = GridSettings(kp_max=options.kp_max) if options.grid else None
    wanted = guard_range(reach(compared(options, box), grid, box.base_gains))
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("evaluate")
        stack.callback(node.destroy_node)
        settings = declare_parameters(node, settings)
        refuse_unknown_parameters(node)
        stack.enter_context(taken_back(run, node))
        if options.plant != "external":
            start_plant(stack, node, options, box, wanted, run)
        stack.callback(node.disarm)
        stack.callback(quiet.enter_context, undisturbed())
        if not node.meet() or node.box is None:
            return 130
        if options.plant == "external":  # only now it is known whether the graph has a page
            start_page(stack, node, wanted=options.dashboard, keep=node.sayings.keep)
        box = Believed.of_box(node.box)
        controllers = compared(options, box)
        node.unfit = partial(surprise, box)
        node.override = GainOverride(
            guard_range(reach(controllers, grid, box.base_gains)), node.override.say, box.base_gains or BASE
        )
        for path in options.policy:
            node.say(of_policy(policy_file(path)))
        if not rearms(options):
            node.listen_for_enter()
        before: GridSession | None = None
        if grid is not None:
            before = search_on(node, grid, settings, rearm=rearms(options))
            if not before.finished:
                return 130
            if before.search.found:
                controllers.append(FixedGains(*before.search.best, box.base_gains or BASE))
            else:
                node.say("the grid found no gains: even the lowest were stopped (above)", warning=True)
        results = evaluate_on(
            node, controllers, rearm=rearms(options), settings=settings, after=before.watch if before else None
        )
        if results.finished:  # one that was stopped hands nothing over
            node.heir = options.hand_over or ""
    notes = conditions(options, box=box.told, integral=box.integral or "not told")
    if options.plant in ("sim", "emulator"):
        notes["seed"] = options.seed
    json, plot = (Path(name) if name else None for name in (options.json, options.plot))
    show_results(results, run, notes, json=json, plot=plot)
    if results.scores:
        write_page(run, f"Evaluation {run.path.name}", notes, report.sections(results, run.tracking_plot))
        print(f"page: {run.page}", file=sys.stderr)
    return 0 if results.finished else 130


def compared(options: argparse.Namespace, box: Believed) -> list[Controller]:
    """The controllers that the words name, on this box.

    Raises
    ------
    ValueError
        One cannot be used.
    PairingError
        A policy was made for another box.
    """
    for path in options.policy:
        refuse_policy(path, box)
    controllers: list[Controller] = [policy_controller(path) for path in options.policy]
    gains = options.fixed or [(90.0, 15.0), (15.0, 5.0)]
    return controllers + [FixedGains(kp, ki, box.base_gains or BASE) for kp, ki in gains]


def start_plant(
    stack: ExitStack, node: GraphNode, options: argparse.Namespace, box: Believed, wanted: GainRange, run: RunDirectory
) -> None:
    """Start the plant and what runs beside it; PairingError, and nothing runs, if its filter is not this box's."""
    start_page(stack, node, wanted=options.dashboard, keep=node.sayings.keep)
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="hydro-")))
    policies = tuple(map(policy_file, options.policy))
    recording = Path(options.record) if options.record else run.bag if options.recorded else None
    plant = plant_options(options, recording=recording, seed=options.seed, policies=policies)
    if sentence := uncovered(wanted, plant.filter, plant.bench):
        node.say(sentence, warning=True)
    node.unfit = partial(surprise, box)
    node.follow(start_companions(stack, plant, wanted, folder, node.sayings.keep), recording)


def evaluation_settings(options: argparse.Namespace) -> EvaluationSettings:
    """Defaults and what the command line says."""
    names = ("repeats", "settle", "periods", "multisine", "steps")
    given = {name: getattr(options, name) for name in names}
    given["frequencies"] = options.frequencies and tuple(options.frequencies)
    return EvaluationSettings(**{key: value for key, value in given.items() if value is not None})


def search_on(node: GraphNode, grid: GridSettings, settings: EvaluationSettings, *, rearm: bool) -> GridSession:
    """Look for the best fixed gains on the plant, by short runs; not `finished` if a signal came before."""
    short = replace(settings, settle=1.0, measure=2.0, periods=1, repeats=1)
    session = GridSession(grid, short, node, rearm=rearm, override=node.override, requirements=node.requirements)
    told = 0

    def tick() -> None:
        nonlocal told
        for pair, rmse in list(session.search.tried.items())[told:]:
            cells = " ".join(f"{value:.1f}" for value in rmse)
            node.say(f"grid ({pair[0]:g}, {pair[1]:g}): RMSE {cells} N")
            told += 1

    node.drive(session, tick)
    tick()
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
) -> EvaluationSession:
    """Run an evaluation on a node that is up; what is there when a signal comes is returned all the same.

    `after` is the watch of the session before, if there was one.
    """
    session = EvaluationSession(
        settings or EvaluationSettings(),
        controllers,
        node,
        rearm=rearm,
        after=after,
        override=node.override,
        requirements=node.requirements,
    )
    bar = EvaluationProgress(session)
    try:
        node.drive(session, bar.tick)
    finally:
        bar.close()
    return session


def reach(
    controllers: Sequence[Controller], grid: GridSettings | None = None, base: tuple[float, float] | None = None
) -> GainRange:
    """The gain changes that the plant's guard must let through, on a box with these base gains."""
    ranges = [controller.reach for controller in controllers]
    if grid is not None:
        corners = ((grid.kp_min, grid.ki_min), (grid.kp_max, grid.ki_max))
        ranges += [FixedGains(*pair, base or BASE).reach for pair in corners]
    return GainRange(
        delta_kp_min=min(r.delta_kp_min for r in ranges),
        delta_kp_max=max(r.delta_kp_max for r in ranges),
        delta_ki_min=min(r.delta_ki_min for r in ranges),
        delta_ki_max=max(r.delta_ki_max for r in ranges),
    )
