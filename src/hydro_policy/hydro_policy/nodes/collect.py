# SPDX-License-Identifier: Apache-2.0
"""Plays a random schedule of references and gains into the graph and records it, as training data.

ros2 run hydro_policy collect --out BAG [--seconds S] [--seed N] [--schedule FILE] [--bench FILE] [--rearm auto|ask]
ros2 run hydro_policy collect --write-schedule FILE [--seconds S] [--seed N]

The bench at rest is recorded first, and the plant is left disarmed with a reference of 0 N in any case.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

import yaml

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.ros.companion import Companion, CompanionError, add_dashboard_option, start_dashboard
from hydro_bridge.ros.node import leave_graph, refuse_unknown_parameters, running_ros
from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.cli.console import UserError, bounded_number, command, writable_file, writable_folder
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Plan, Trial
from hydro_policy.nodes.graph_node import CleanupStack, GraphNode
from hydro_policy.nodes.plant_options import add_option
from hydro_policy.nodes.progress import TrialProgress
from hydro_policy.task.cases import Case, Score
from hydro_sim.box.box import EMULATED_BOX
from hydro_sim.excitation import ExcitationRange, Segment, draw_schedule, load_schedule, save_schedule
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.bench import NOMINAL, Bench

SCHEDULE_TIME = 600.0  # s of a schedule, by default
REST_TIME = 1.0  # s of the bench at rest, recorded before arming
CONSECUTIVE_TRIPS_MAX = 3
LEASE_TIMEOUT = 5.0  # timeout for the lease on the plant, s: longer than it keeps the lease of a killed node
TRIPPED_STATUS = 3  # exit status after `CONSECUTIVE_TRIPS_MAX` trips: the recording is complete up to there


class SchedulePlan(Plan):
    """Plan of a schedule: each segment an unscored trial, until `CONSECUTIVE_TRIPS_MAX` in a row trip the plant.

    `schedule`: segments with total gains. `base`: base gains of the box, K_p [1/s] and K_i [1/s^2].
    """

    def __init__(self, schedule: Sequence[Segment], base: tuple[float, float]) -> None:
        self._schedule, self._base = schedule, base
        self.total = sum(one.seconds for one in schedule)
        self.played = 0.0  # s of the segments that were played to their end
        self.trips = self.in_a_row = 0
        self.set_trials(self._in_turn())

    def _in_turn(self) -> Generator[Trial, Score, None]:
        for one in self._schedule:
            controller, case = FixedGains(one.kp, one.ki, self._base), Case(one.waveform, one.signal)
            score = yield Trial(controller=controller, case=case, settle=0.0, measure=one.seconds, is_scored=False)
            self.trips += bool(score.stopped)
            self.in_a_row = self.in_a_row + 1 if score.stopped else 0
            self.done += one.seconds
            self.played += 0.0 if score.stopped else one.seconds
            if self.end_reason:
                return

    @property
    def end_reason(self) -> str:
        """Reason for ending before the schedule's end; empty if there is none."""
        many = self.in_a_row >= CONSECUTIVE_TRIPS_MAX
        return f"the plant tripped {self.in_a_row} times in a row: it is left disarmed" if many else ""


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="collect",
        description="Record random references and gains for training.",
        epilog=f"It ends with status {TRIPPED_STATUS} after {CONSECUTIVE_TRIPS_MAX} trips in a row, and leaves the "
        "plant disarmed.",
    )
    made.add_argument("--out", type=writable_folder, metavar="BAG", help="recording to make")
    made.add_argument(
        "--seconds", type=bounded_number(1.0, 36000.0), help=f"length of the schedule (default: {SCHEDULE_TIME:g})"
    )
    made.add_argument("--seed", type=bounded_number(0), help="of the schedule (default: 1)")
    made.add_argument(
        "--schedule", metavar="FILE", help="play this one instead of drawing one (docs/manual/reference/schedule.md)"
    )
    made.add_argument(
        "--write-schedule", type=writable_file, metavar="FILE", help="write the schedule, for instance for the emulator"
    )
    made.add_argument(
        "--bench", metavar="FILE", help="bench.yaml of the box, kept in the recording (default: as the box says)"
    )
    add_option(made, "rearm")
    add_dashboard_option(made)
    return made


@command(ValueError, OSError, CompanionError, NotReadyError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    if not (options.out or options.write_schedule):
        parser().error("give --out, --write-schedule, or both")
    if options.schedule and (options.seconds, options.seed) != (None, None):
        parser().error("--seconds and --seed draw a schedule: --schedule FILE has its own")
    options.seconds, options.seed = options.seconds or SCHEDULE_TIME, 1 if options.seed is None else options.seed
    bench = Bench.load(options.bench) if options.bench else None
    if options.schedule:
        schedule = load_schedule(options.schedule)
        for index, segment in enumerate(schedule):
            if segment.delta_u:
                why = "only the emulator records corrections"
                raise UserError(f"segments[{index}].delta_u is {segment.delta_u:g} A: {why}")
    else:
        force = (bench.size if bench else NOMINAL).force
        schedule = draw_schedule(options.seconds, options.seed, ExcitationRange.of_force(force))
    if options.write_schedule:
        save_schedule(schedule, options.write_schedule)
        print(f"{options.write_schedule}: {len(schedule)} segments, {sum(s.seconds for s in schedule):g} s")
    if not options.out:
        return 0
    if options.out.exists():
        raise UserError(f"{options.out} exists already; a recording is never overwritten")
    with running_ros(ros):
        plan = collect(options, schedule, bench)
    if plan.end_reason:
        print(f"error: {plan.end_reason}; {options.out} holds what was played so far", file=sys.stderr)
        return TRIPPED_STATUS
    if plan.trips:
        print(f"the plant tripped {plan.trips} times; the schedule went on with the next segment")
    print(f"{options.out}: {plan.played:g} s played" + (" to their end" if plan.trips else ""))
    return 0


def collect(options: argparse.Namespace, schedule: Sequence[Segment], bench: Bench | None) -> SchedulePlan:
    """Play the schedule while it is recorded; returns its plan, with the trips and the time played."""
    with CleanupStack() as stack:
        node = GraphNode("collect", lease_wait_max=LEASE_TIMEOUT)
        stack.callback(leave_graph, node)
        refuse_unknown_parameters(node)
        if not node.wait_for_plant() or node.box is None:
            raise UserError("interrupted before anything was recorded")
        box = node.box
        if bench is None:
            bench = Bench.from_mapping(yaml.safe_load(box.bench)) if box.bench else Bench.nominal()
        elif box.bench_digest not in ("", bench.digest):
            told = f"--bench is bench {bench.digest}, the box believes {BoxIdentity.of_box(box).description}"
            raise PairingError(f"{told}: name the bench.yaml of this box, or none")
        plan, plant = SchedulePlan(schedule, box.base_gains), "sim" if box.plant == "sim" else box.info.name
        rearm = options.rearm == "auto" if options.rearm else plant in ("sim", EMULATED_BOX)
        node.box_fault = lambda other: (
            "" if other.base_gains == box.base_gains else "another box with other base gains has been connected"
        )
        start_dashboard(stack, node, wanted=options.dashboard, log=node.announcer.write_log)
        scratch = Path(stack.enter_context(TemporaryDirectory()))
        save_schedule(schedule, scratch / "schedule.yaml")
        (scratch / "bench.yaml").write_text(yaml.safe_dump(bench.to_mapping(), sort_keys=False), encoding="utf-8")
        words = ["--out", str(options.out), "--metadata", f"plant={plant or 'unknown'}"]
        words += [] if options.schedule else [f"seed={options.seed}"]
        words += ["--attach", str(scratch / "schedule.yaml"), str(scratch / "bench.yaml")]
        behind = stack.enter_context(ExitStack())  # what is undone once the recorder has ended
        recorder = stack.enter_context(Companion("hydro_bridge", "recorder", words))
        node.watch_companions([recorder], options.out)
        node.companions.unrecorded = "the plant is disarmed"
        stack.callback(node.disarm, still=True)
        runner = TrialRunner(plan, node.supervisor(rest_recorded_requirement(node), rearm=rearm, filtered=False))
        bar = TrialProgress(runner, "collecting")
        stack.callback(bar.close)

        def tick() -> None:
            bar.tick()
            if not recorder.running:  # nothing moves unrecorded
                why = recorder.last_line.removeprefix("error: ")
                node.fail(UserError(f"the recorder has ended, so the plant was disarmed: {why}"))

        if not rearm:
            node.listen_for_enter()
        try:
            if not node.run_session(runner, tick):
                begun = node.timing.response.count > 0
                kept = f"{options.out} holds what was played so far" if begun else "nothing was played"
                raise UserError(f"interrupted: {kept}")
        except (NotReadyError, CompanionError, UserError):
            if not node.timing.response.count and recorder.running:  # nothing played: no folder
                behind.callback(rmtree, options.out, ignore_errors=True)
            raise
    return plan


def rest_recorded_requirement(node: GraphNode) -> Requirement:
    """Return the requirement that a second of the bench at rest is recorded before arming.

    Call it after `GraphNode.watch_companions`.
    """
    (recording,) = node.requirements
    since = inf  # when the recorded bench came to rest, s; -inf: recorded

    def recorded() -> bool:
        nonlocal since
        if since > -inf:
            since = min(since, node.now()) if recording.ready() and not node.armed else inf
            since = -inf if node.now() - since >= REST_TIME else since
        return since == -inf

    name = "a second of the still bench"
    missing = f"{name} was not recorded: leave it disarmed"
    return Requirement(name=name, ready=recorded, hint="it is recorded first", timeout=600.0, timeout_message=missing)
