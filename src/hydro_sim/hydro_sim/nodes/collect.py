# SPDX-License-Identifier: Apache-2.0
"""Plays a random schedule of references and gains into the graph and records it, as training data.

ros2 run hydro_sim collect --out BAG [--seconds S] [--seed N] [--schedule FILE] [--bench FILE] [--rearm auto|ask]
ros2 run hydro_sim collect --write-schedule FILE [--seconds S] [--seed N]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

import numpy as np
import rclpy
import yaml

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, number, writable, writable_folder
from hydro_bridge.ros.companion import Companion, CompanionError, add_page_option, start_page
from hydro_bridge.ros.node import refuse_unknown_parameters, ros_arguments, start_ros
from hydro_bridge.signals import Flag, StateArray
from hydro_bridge.size import Size
from hydro_sim.excitation import Range, Segment, draw, load_schedule, save_schedule
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.nodes.collecting import TRIPS_IN_A_ROW, CollectNode
from hydro_sim.plotting import UNITS

WORKING_RANGE: dict[str, tuple[str, float, float]] = {
    "load_force": ("force", -400.0, 400.0),
    "load_force_rate": ("force", -3770.0, 3770.0),
    "pressure_a": ("pressure", 4e6, 9e6),
    "pressure_b": ("pressure", 5e6, 14e6),
    "piston_position": ("length", 0.02, 0.06),
    "piston_velocity": ("length", -0.19, 0.19),
    "valve_current": ("current", -5e-3, 5e-3),
    "proportional_gain": ("", 15.0, 75.0),
    "integral_gain": ("", 5.0, 15.0),
}
"""Scale of `Size`, and working range of a model of the nominal bench: 300 N at 2 Hz with offsets (physics.md), SI."""


def working_range(size: Size) -> dict[str, tuple[float, float]]:
    """Return the working range of a model of a bench of this size, SI units."""
    shares = {name: getattr(size, name) / getattr(NOMINAL, name) for name in vars(NOMINAL)} | {"": 1.0}
    return {field: (shares[scale] * low, shares[scale] * high) for field, (scale, low, high) in WORKING_RANGE.items()}


BINS = 20


def coverage(states: StateArray, size: Size) -> Table:
    """One row per quantity: its range, its spread, and how much of the bench's working range was visited while armed.

    `visited` is the share of 20 bins of the working range with at least 0.1 % of the samples; the last row is the share
    of cells of load force by velocity, 10 each way, within the ellipse that sines of 400 N and 3770 N/s fill (on the
    nominal bench).
    """
    armed = states[(states["flags"] & Flag.ARMED) != 0]
    seconds = 1e-3 * len(armed)
    columns = {
        "quantity": "", "unit": "", "low": "0.1 % of samples are below", "high": "0.1 % of samples are above",
        "std": "standard deviation", "visited": "share of the working range visited",
    }  # fmt: skip
    table = Table(columns, title=f"{seconds:g} s armed of {1e-3 * len(states):g} s")
    ranges = working_range(size)
    for field in ranges:
        name, unit, factor = UNITS[field]
        values = armed[field]
        low, high = np.quantile(values, [0.001, 0.999])
        counts, _ = np.histogram(values, BINS, ranges[field])
        table.add(
            quantity=name, unit=unit, low=float(factor * low), high=float(factor * high),
            std=float(factor * values.std()),
            visited=float((counts > 0.001 * len(values)).mean()),
        )  # fmt: skip
    table.add(quantity="force by velocity", unit="", low=np.nan, high=np.nan, std=np.nan, visited=_plane(armed, size))
    return table


def _plane(armed: StateArray, size: Size) -> float:
    ranges = [working_range(size)[field] for field in ("load_force", "piston_velocity")]
    counts, force, velocity = np.histogram2d(armed["load_force"], armed["piston_velocity"], 10, ranges)
    f, v = 0.5 * (force[1:] + force[:-1]) / ranges[0][1], 0.5 * (velocity[1:] + velocity[:-1]) / ranges[1][1]
    inside = f[:, None] ** 2 + v[None, :] ** 2 <= 1.0
    return float((counts[inside] >= 10).mean())


TRIPPED = 3
"""Exit status after `TRIPS_IN_A_ROW` trips: the recording is complete up to there."""


def _play(schedule: Sequence[Segment], bench: Bench | None, options: argparse.Namespace, ros: Sequence[str]) -> str:
    """Record while the schedule plays; return why the plant could not continue, or nothing.

    Raises UserError if it was interrupted, the recorder ended, another node drives the plant, or its box believes
    another bench.
    """
    start_ros(ros)
    try:
        node = CollectNode(schedule, None if options.rearm is None else options.rearm == "auto")
        try:
            refuse_unknown_parameters(node)
            if node.meet():
                raise UserError("interrupted before anything was recorded")
            lost, broken = _record(node, schedule, _bench_of(node, bench), options)
        finally:
            node.leave()
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    if lost:
        raise UserError(f"the recorder has ended, so the plant was disarmed: {lost}")
    if broken:
        raise UserError(f"interrupted: {options.out} holds what was played so far")
    tripped_out = node.playback.trips_in_a_row >= TRIPS_IN_A_ROW
    if node.ended and not tripped_out:
        if not node.playback.elapsed:  # what is refused leaves no folder
            rmtree(options.out)
        raise UserError(node.ended)
    if node.playback.trips and not tripped_out:
        print(f"the plant tripped {node.playback.trips} times; the schedule went on after it was armed again")
    return node.ended


def _bench_of(node: CollectNode, asked: Bench | None) -> Bench:
    """Return the bench.yaml to store in the recording: the requested one, or else the one that the box believes.

    Raises PairingError if the box believes another one than requested.
    """
    box = node.box
    if asked is None:
        return Bench.from_mapping(yaml.safe_load(box.bench)) if box is not None and box.bench else Bench.nominal()
    if box is not None and box.bench_digest not in ("", asked.digest):
        told = f"--bench is bench {asked.digest}, the box believes {BoxIdentity.of_box(box).description}"
        raise PairingError(f"{told}: name the bench.yaml of this box, or none")
    return asked


def _record(
    node: CollectNode, schedule: Sequence[Segment], bench: Bench, options: argparse.Namespace
) -> tuple[str, bool]:
    """Drive the plant beside a recorder; return why recording ended, and whether a signal ended it."""
    drawn = [] if options.schedule else [f"seed={options.seed}"]
    words = ["--out", str(options.out), "--metadata", f"plant={node.plant or 'unknown'}", *drawn]
    with ExitStack() as stack:
        scratch = stack.enter_context(TemporaryDirectory())
        start_page(stack, node, wanted=options.dashboard)
        kept = [Path(scratch, "schedule.yaml"), Path(scratch, "bench.yaml")]
        save_schedule(schedule, kept[0])
        kept[1].write_text(yaml.safe_dump(bench.to_mapping(), sort_keys=False), encoding="utf-8")
        attached = [*words, "--attach", *map(str, kept)]
        recorder = stack.enter_context(Companion("hydro_bridge", "recorder", attached))
        try:
            broken = node.drive(recorder, options.out)
            return _why_ended(recorder, options.out), broken
        finally:
            node.leave()


def _why_ended(recorder: Companion, out: Path) -> str:
    """Return why recording ended; empty while it runs."""
    if recorder.running:
        return ""
    if recorder.process.returncode == 2:  # it could not use `out`
        return recorder.last_line.removeprefix("error: ")
    return f"the recorder ended (exit status {recorder.process.returncode}); {out} holds what came before"


@command(ValueError, OSError, CompanionError)
def main() -> int:
    """Entry point."""
    own, ros = ros_arguments()
    options = _arguments(own)
    bench = Bench.load(options.bench) if options.bench else None
    if options.schedule:
        schedule = _playable(load_schedule(options.schedule))
    else:
        force = (bench.size if bench else NOMINAL).force
        schedule = draw(options.seconds, options.seed, Range.of_force(force))
    if options.write_schedule:
        save_schedule(schedule, options.write_schedule)
        print(f"{options.write_schedule}: {len(schedule)} segments, {sum(s.seconds for s in schedule):g} s")
    if not options.out:
        return 0
    if options.out.exists():
        raise UserError(f"{options.out} exists already; a recording is never overwritten")
    trouble = _play(schedule, bench, options, ros)
    recorded = read_bag(options.out)
    played = Bench.from_mapping(yaml.safe_load(recorded.attachments["bench.yaml"]))
    coverage(recorded.state, played.size).show(options.json)
    if trouble:
        print(f"error: {trouble}; {options.out} holds what was played so far", file=sys.stderr)
    return TRIPPED if trouble else 0


def _playable(schedule: Sequence[Segment]) -> Sequence[Segment]:
    """Return the schedule if it has no corrections: those are the filter's; only the emulator records others."""
    for index, segment in enumerate(schedule):
        if segment.delta_u:
            raise UserError(
                f"segments[{index}].delta_u is {segment.delta_u:g} A: only the emulator records corrections"
            )
    return schedule


def _arguments(own: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="collect",
        description="Record random references and gains for training.",
        epilog=f"It ends with status {TRIPPED} after {TRIPS_IN_A_ROW} trips in a row, and leaves the plant disarmed.",
    )
    parser.add_argument("--out", type=writable_folder, metavar="BAG", help="recording to make")
    parser.add_argument("--seconds", type=number(1.0, 36000.0), default=600.0, help="length of the schedule")
    parser.add_argument("--seed", type=number(0), default=1, help="of the schedule")
    parser.add_argument(
        "--schedule", metavar="FILE", help="play this one instead of drawing one (docs/manual/reference/schedule.md)"
    )
    parser.add_argument(
        "--write-schedule", type=writable, metavar="FILE", help="write the schedule, for instance for the emulator"
    )
    parser.add_argument(
        "--bench",
        metavar="FILE",
        help="bench.yaml of the box, kept in the recording (default: as the box says)",
    )
    parser.add_argument(
        "--rearm",
        choices=("auto", "ask"),
        help="who arms: auto (default with sim and emulator), or you on purpose (otherwise), by Enter or `arm`",
    )
    add_page_option(parser)
    add_json_argument(parser)
    options = parser.parse_args(own)
    if not (options.out or options.write_schedule):
        parser.error("give --out, --write-schedule, or both")
    return options
