# SPDX-License-Identifier: Apache-2.0
"""Plays a random schedule of references and gains into the graph and records it, as training data.

ros2 run hydro_policy collect --out BAG [--seconds S] [--seed N] [--schedule FILE] [--bench FILE] [--rearm auto|ask]
ros2 run hydro_policy collect --write-schedule FILE [--seconds S] [--seed N]

The still bench is recorded first, and the plant is left disarmed with a reference of 0 N, whatever happens.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

import yaml
from tqdm import tqdm

from hydro_bridge.ros.companion import Companion, CompanionError, add_page_option, start_page
from hydro_bridge.ros.node import leave_graph, refuse_unknown_parameters, ros_arguments, running_ros
from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.cli.console import UserError, command, number, progress, writable, writable_folder
from hydro_core.process.endings import undisturbed
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.sessions.playing import TRIPS_IN_A_ROW, PlayingSession
from hydro_sim.box.box import EMULATED_BOX
from hydro_sim.excitation import Range, Segment, draw, load_schedule, save_schedule
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.bench import NOMINAL, Bench

AUTHORITY_WITHIN = 5.0
"""s for the plant to give the authority: longer than it keeps that of one who was killed."""
TRIPPED = 3
"""Exit status after `TRIPS_IN_A_ROW` trips: the recording is complete up to there."""


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="collect",
        description="Record random references and gains for training.",
        epilog=f"It ends with status {TRIPPED} after {TRIPS_IN_A_ROW} trips in a row, and leaves the plant disarmed.",
    )
    made.add_argument("--out", type=writable_folder, metavar="BAG", help="recording to make")
    made.add_argument("--seconds", type=number(1.0, 36000.0), default=600.0, help="length of the schedule")
    made.add_argument("--seed", type=number(0), default=1, help="of the schedule")
    made.add_argument(
        "--schedule", metavar="FILE", help="play this one instead of drawing one (docs/manual/reference/schedule.md)"
    )
    made.add_argument(
        "--write-schedule", type=writable, metavar="FILE", help="write the schedule, for instance for the emulator"
    )
    made.add_argument(
        "--bench", metavar="FILE", help="bench.yaml of the box, kept in the recording (default: as the box says)"
    )
    made.add_argument(
        "--rearm",
        choices=("auto", "ask"),
        help="who arms: auto (default with sim and emulator), or you on purpose (otherwise), by Enter or `arm`",
    )
    add_page_option(made)
    return made


@command(ValueError, OSError, CompanionError, NotReadyError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    if not (options.out or options.write_schedule):
        parser().error("give --out, --write-schedule, or both")
    bench = Bench.load(options.bench) if options.bench else None
    schedule = playable(options, (bench.size if bench else NOMINAL).force)
    if options.write_schedule:
        save_schedule(schedule, options.write_schedule)
        print(f"{options.write_schedule}: {len(schedule)} segments, {sum(s.seconds for s in schedule):g} s")
    if not options.out:
        return 0
    if options.out.exists():
        raise UserError(f"{options.out} exists already; a recording is never overwritten")
    with running_ros(ros):
        session = collect(options, schedule, bench)
    playback = session.playback
    if session.ended:
        print(f"error: {session.ended}; {options.out} holds what was played so far", file=sys.stderr)
        return TRIPPED
    if playback.trips:
        print(f"the plant tripped {playback.trips} times; the schedule went on after it was armed again")
    print(f"{options.out}: {playback.elapsed:.1f} s armed")
    return 0


def playable(options: argparse.Namespace, force: float) -> Sequence[Segment]:
    """Return the schedule of the command line, drawn for a bench of this force [N] if it names none.

    Raises UserError: it has corrections, which are the filter's; only the emulator records others.
    """
    if not options.schedule:
        return draw(options.seconds, options.seed, Range.of_force(force))
    schedule = load_schedule(options.schedule)
    for index, segment in enumerate(schedule):
        if segment.delta_u:
            raise UserError(
                f"segments[{index}].delta_u is {segment.delta_u:g} A: only the emulator records corrections"
            )
    return schedule


def collect(options: argparse.Namespace, schedule: Sequence[Segment], bench: Bench | None) -> PlayingSession:
    """Record while the schedule plays; returns the session as it ended.

    Raises UserError: it was interrupted, or the recorder ended; PairingError, before anything is recorded: the box
    believes another bench; NotReadyError: another node commands the plant; CompanionError: the box is another one now.
    """
    with ExitStack() as quiet, ExitStack() as stack:
        node = GraphNode("collect", alone_within=AUTHORITY_WITHIN)
        stack.callback(leave_graph, node)
        refuse_unknown_parameters(node)
        if not node.wait_for_plant() or node.box is None:
            raise UserError("interrupted before anything was recorded")
        box, believed = node.box, believed_bench(node.box, bench)
        plant = "sim" if box.plant == "sim" else box.info.name
        rearm = options.rearm == "auto" if options.rearm else plant in ("sim", EMULATED_BOX)
        node.box_fault = lambda other: (
            "" if other.base_gains == box.base_gains else "another box with other base gains has been connected"
        )
        start_page(stack, node, wanted=options.dashboard, keep=node.announcer.keep)
        recorder = start_recorder(stack, options, schedule, believed, plant)
        node.watch_companions([recorder], options.out)
        (recording,) = node.requirements
        stack.callback(node.disarm)
        stack.callback(quiet.enter_context, undisturbed())  # a second Ctrl-C waits
        session = PlayingSession(
            schedule, box.base_gains, lambda rest: node.supervisor(rest, rearm=rearm, filtered=False), recording.ready
        )
        bar: tqdm[None] = stack.enter_context(
            progress(total=round(session.playback.seconds), label="collecting", unit="s")
        )

        def tick() -> None:
            bar.update(int(session.playback.elapsed) - bar.n)
            if not recorder.running:  # nothing moves unrecorded
                why = why_ended(recorder, options.out)
                node.fail(UserError(f"the recorder has ended, so the plant was disarmed: {why}"))

        if not rearm:
            node.listen_for_enter()
        try:
            finished = node.run_session(session, tick)
        except (NotReadyError, CompanionError, UserError):
            if not session.playback.elapsed and recorder.running:  # what is refused leaves no folder
                quiet.callback(rmtree, options.out)  # once the recorder has ended
            raise
        if not finished:
            raise UserError(f"interrupted: {options.out} holds what was played so far")
    return session


def believed_bench(box: KnownBox, asked: Bench | None) -> Bench:
    """Return the bench.yaml to store in the recording: the requested one, or else the one that the box believes.

    Raises PairingError: the box believes another one than requested.
    """
    if asked is None:
        return Bench.from_mapping(yaml.safe_load(box.bench)) if box.bench else Bench.nominal()
    if box.bench_digest not in ("", asked.digest):
        told = f"--bench is bench {asked.digest}, the box believes {BoxIdentity.of_box(box).description}"
        raise PairingError(f"{told}: name the bench.yaml of this box, or none")
    return asked


def start_recorder(
    stack: ExitStack, options: argparse.Namespace, schedule: Sequence[Segment], bench: Bench, plant: str
) -> Companion:
    """Start the recorder, with schedule and bench file attached, for as long as `stack` holds."""
    scratch = Path(stack.enter_context(TemporaryDirectory()))
    save_schedule(schedule, scratch / "schedule.yaml")
    (scratch / "bench.yaml").write_text(yaml.safe_dump(bench.to_mapping(), sort_keys=False), encoding="utf-8")
    drawn = [] if options.schedule else [f"seed={options.seed}"]
    words = ["--out", str(options.out), "--metadata", f"plant={plant or 'unknown'}", *drawn]
    attached = [*words, "--attach", str(scratch / "schedule.yaml"), str(scratch / "bench.yaml")]
    return stack.enter_context(Companion("hydro_bridge", "recorder", attached))


def why_ended(recorder: Companion, out: Path) -> str:
    """Return why a recorder has ended."""
    if recorder.process.returncode == 2:  # it could not use `out`
        return recorder.last_line.removeprefix("error: ")
    return f"the recorder ended (exit status {recorder.process.returncode}); {out} holds what came before"
