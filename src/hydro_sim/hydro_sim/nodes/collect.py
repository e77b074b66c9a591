# SPDX-License-Identifier: Apache-2.0
"""Plays a random schedule of references and gains into the graph and records it, as training data.

ros2 run hydro_sim collect --out BAG [--seconds S] [--seed N] [--schedule FILE] [--bench FILE] [--rearm auto|ask]
ros2 run hydro_sim collect --write-schedule FILE [--seconds S] [--seed N]

`CollectNode` plays it, and leaves the plant disarmed::

    meet     which box is it, may this node command it, and arm it without a person (simulation, emulator)?
    drive    wait for the recorder, record the still bench, arm, play, arm again after a trip; too many trips end it
    leave    reference 0 N, and a disarm that the plant confirms
"""

from __future__ import annotations

import argparse
import queue
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from math import inf
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future

from hydro_bridge.ros.answers import Answers
from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.companion import Companion, CompanionError, RecorderWatch, add_page_option, start_page
from hydro_bridge.ros.diagnostics import publisher_conflicts
from hydro_bridge.ros.messages import seconds, subscribe_to_box
from hydro_bridge.ros.node import leave_graph, refuse_unknown_parameters, ros_arguments, running_ros, spin
from hydro_bridge.ros.topics import COMMANDS, STATE, create_subscription
from hydro_bridge.safety.arming import TOO_EARLY, Arming
from hydro_bridge.safety.authority import BY_HAND
from hydro_bridge.safety.box_info import KnownBox, box_info_requirement
from hydro_bridge.safety.pace import COMMANDS as COMMANDS_WINDOW
from hydro_bridge.safety.readiness import NotReadyError, Readiness, Requirement
from hydro_core.cli.console import (
    UserError,
    command,
    number,
    print_above_progress,
    progress,
    typed_lines,
    writable,
    writable_folder,
)
from hydro_core.process import endings
from hydro_core.signals import SAMPLES_PER_STEP, Flag
from hydro_core.signals import ReferenceSignal as Signal
from hydro_msgs.msg import BenchState
from hydro_sim.box.box import EMULATED_BOX
from hydro_sim.excitation import Playback, Range, Segment, draw, load_schedule, save_schedule
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.bench import NOMINAL, Bench

NOT_YET = "not armed, still waiting for {}: you are asked once all is ready"
TRIPS_IN_A_ROW = 3
_PERIOD = 0.01  # s, of gains
_REST = 1.0  # s recorded before arming: the still bench
_AUTHORITY_WITHIN = 5.0  # s for the plant to give the authority: longer than it keeps that of one who was killed
_PLANT_WITHIN = 600.0  # s without a sample


class CollectNode(Node):
    """Call `meet`, then `drive`, and `leave` whatever happens.

    `schedule`: schedule to play. `rearm`: whether the plant may be armed without a person; None: if it is the
    simulation or the emulator.
    """

    def __init__(self, schedule: Sequence[Segment], rearm: bool | None) -> None:
        super().__init__("collect")
        self.plant = ""
        """Name of the plant, once it is met: sim, or the box's own name; empty if unknown."""
        self.ended = ""
        """Reason for ending before the schedule did, if it ended by itself."""
        self.playback = Playback(schedule)
        self._rearm = rearm
        self.box: KnownBox | None = None
        """Box that the plant reports: schedules state total gains, and a box takes changes to its own."""
        self._heard = self._asked = inf  # when the first sample came; when the authority was first asked for, s
        self._readiness = Readiness([self._plant_needed(), box_info_requirement(lambda: self.box is not None)], _warn)
        self._met, self._finished, self._driving = Future(), Future(), False
        self._recorder: Companion | None = None
        self._begun, self._still_since = False, inf  # whether it may be armed; since when it is not, s
        self._changes = (0.0, 0.0)  # to K_p [1/s] and K_i [1/s^2] of the box
        self._bar: Any = None
        self._commander = Commander(self, self._on_authority, endings.ask)
        self._arming = Arming(self, rearm=False)
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._refusals = {True: "", False: ""}  # the last one to arm, and to disarm
        self._state: BenchState | None = None
        self._owed: int | None = None  # sample whose answer is due to a plant that goes by its own clock
        self._answers = Answers(self, COMMANDS_WINDOW, create_subscription(self, STATE, self._on_state))
        self._commander.settled = self._answer
        subscribe_to_box(self, self._on_box)
        self.create_timer(_PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def meet(self) -> bool:
        """Wait for a plant and check it; return whether a signal ended the wait.

        Raises UserError if another node commands the plant, no plant appears, or the box is unknown.
        """
        broken = spin(self, self._met)
        if not broken and self.ended:
            raise UserError(self.ended)
        return broken

    def drive(self, recorder: Companion, bag: Path) -> bool:
        """Play while the recorder runs, once it has samples in `bag`; return whether a signal ended it."""
        self._recorder, self._driving = recorder, True
        self._readiness = Readiness([RecorderWatch(self, bag, recorder).requirement], _warn)
        self._bar = progress(total=round(self.playback.seconds), label="collecting", unit="s")
        self._arming.alone = bool(self._rearm)
        if not self._rearm:
            self._keys = typed_lines()
        return spin(self, self._finished)

    def leave(self) -> None:
        """Leave the plant disarmed, with a reference of 0 N for whoever arms it next, and give back the authority."""
        with endings.undisturbed():  # a second Ctrl-C waits
            self._driving = False
            self._commander.reference(Signal())
            self._commander.flush()
            if unconfirmed := self._commander.give_back():
                _warn(unconfirmed)
            if self._bar is not None:  # after the plant: there may be no terminal any more
                self._bar.close()

    def _on_state(self, message: BenchState) -> None:
        self._heard = min(self._heard, time.monotonic())
        self._state = message
        self._commander.collects = self._paced
        self.playback.on_sample(message.flags)
        if self._paced and message.sequence % SAMPLES_PER_STEP == 0:
            self._act(seconds(message.header.stamp))
            self._owed = message.sequence
            self._answer()

    @property
    def _paced(self) -> bool:
        """Whether the plant goes by its own clock."""
        return self._state is not None and bool(self._state.flags & Flag.PACED)

    def _on_timer(self) -> None:
        if not self._paced:
            self._act(time.monotonic())
        self._answer()

    def _act(self, now: float) -> None:
        if self._driving:
            self._drive_on(now)
        elif not self._met.done():
            self._look_around(now)

    def _answer(self) -> None:
        """Answer a plant that waits, unless it has still to answer a request."""
        if self._owed is not None and self._paced and not self._commander.requests:
            self._answers.answer(self._owed, self._commander.flush())
            self._owed = None

    def _look_around(self, now: float) -> None:
        if not self._ready(now):
            return
        self._commander.seek(now)
        self._asked = min(self._asked, now)
        if not self._commander.held and now - self._asked < _AUTHORITY_WITHIN:
            return
        if not self._commander.held:
            self.ended = self._commander.refusal or "the plant does not say who may command it (/hydro/claim)"
        elif crowd := publisher_conflicts(self, *COMMANDS):
            self.ended = crowd
        if self._rearm is None:
            self._rearm = self.plant in ("sim", EMULATED_BOX)
        self._met.set_result(None)

    def _on_box(self, box: KnownBox) -> None:
        if self._driving and self.box is not None and box.base_gains != self.box.base_gains:
            self._end("another box with other base gains has been connected: it is left disarmed")
        self.box, self.plant = box, "sim" if box.plant == "sim" else box.info.name

    def _drive_on(self, now: float) -> None:
        if self._finished.done():
            return
        self._commander.seek(now)
        if self._recorder is None or not self._recorder.running:  # nothing moves unrecorded
            self._end("")
            return
        if not self._begun:
            self._wait_to_begin(now, armed=bool(self.playback.flags & Flag.ARMED))
            return
        self._follow_schedule()
        self._follow_arming(now)
        self._commander.gains(*self._changes)

    def _wait_to_begin(self, now: float, *, armed: bool) -> None:
        """Wait until the recorder has a second of the bench at rest; if somebody arms it meanwhile, it is disarmed."""
        ready = self._ready(now) and not armed
        self._still_since = min(self._still_since, now) if ready else inf
        if self._entered():
            _warn(NOT_YET.format(self._readiness.awaited or "a second of the still bench"))
        if armed:
            self._arming.lower(now, TOO_EARLY)
        else:
            self._arming.seek(False, now)
        self._begun = now - self._still_since >= _REST

    def _ready(self, now: float) -> bool:
        """Return whether what must be there is; what never comes is the end."""
        try:
            self._readiness.look(now)
        except NotReadyError as error:
            self._end(str(error))
        return self._readiness.complete

    def _plant_needed(self) -> Requirement:
        return Requirement(
            name="a plant",
            ready=lambda: self._heard < inf,
            hint=f"no samples on {STATE} yet: start a bridge or a simulation",
            within=_PLANT_WITHIN,
            missing=f"no samples on {STATE} for {_PLANT_WITHIN:g} s: there is nothing to record",
        )

    def _follow_schedule(self) -> None:
        segment, playback = self.playback.next(), self.playback
        if playback.trips_in_a_row >= TRIPS_IN_A_ROW:
            self._end(f"the plant tripped {playback.trips_in_a_row} times in a row: it is left disarmed")
        elif playback.finished:
            self._end("")
        if segment is not None and self.box is not None:
            self._commander.reference(segment.signal)
            self._changes = segment.kp - self.box.info.base_kp, segment.ki - self.box.info.base_ki
        if self._bar is not None:
            self._bar.update(int(playback.elapsed) - self._bar.n)

    def _follow_arming(self, now: float) -> None:
        if self._finished.done() or self.playback.flags & Flag.ARMED:
            self._entered()  # consent given while it is armed is none for the next time
            self._arming.rest()
        elif trouble := publisher_conflicts(self, *COMMANDS):
            self._end(f"{trouble}; the plant is left disarmed")
        else:
            if self._entered():
                self._arming.arm(now)
            self._arming.seek(True, now)
            condition = "tripped" if self.playback.flags & Flag.TRIPPED else "disarmed"
            if hint := self._arming.prompt(condition, True, now):
                _warn(f"the plant is {condition}: {hint}" + " --off, then without it" * (condition == "tripped"))

    def _entered(self) -> bool:
        """Return whether a person has pressed Enter since the last call."""
        entered = not self._keys.empty()
        while not self._keys.empty():
            self._keys.get()
        return entered

    def reference(self, signal: Signal) -> None:
        """See `ArmingOutputs`."""
        self._commander.reference(signal)

    def arm(self, arm: bool) -> None:
        """See `ArmingOutputs`; a refusal is reported once, one that a person caused each time."""
        self._commander.arm(arm, partial(self._on_answer, arm))

    def say(self, sentence: str, warning: bool = False) -> None:
        """See `ArmingOutputs`."""
        _warn(sentence)

    def _on_answer(self, arm: bool, answer: Future) -> None:
        refusal = "" if answer.result() is None or answer.result().success else answer.result().message
        if refusal == BY_HAND:
            now = seconds(self._state.header.stamp) if self._paced and self._state else time.monotonic()
            self._arming.leave_to_person(now)
        if refusal == BY_HAND or (refusal and refusal != self._refusals[arm]):
            what = "was not armed" if arm else "did not confirm that it is disarmed"
            _warn(f"the plant {what}: {refusal}")
        self._refusals[arm] = refusal

    def _on_authority(self, lost: str) -> None:
        if lost:
            self._end(f"{lost}; it goes on without this node")

    def _end(self, why: str) -> None:
        over = self._finished if self._driving else self._met
        if not over.done():
            self.ended = why
            over.set_result(None)


def _warn(sentence: str) -> None:
    print_above_progress(f"! {sentence}")


TRIPPED = 3
"""Exit status after `TRIPS_IN_A_ROW` trips: the recording is complete up to there."""


def _play(schedule: Sequence[Segment], bench: Bench | None, options: argparse.Namespace, ros: Sequence[str]) -> str:
    """Record while the schedule plays; return why the plant could not continue, or nothing.

    Raises UserError if it was interrupted, the recorder ended, another node drives the plant, or its box believes
    another bench.
    """
    with running_ros(ros):
        node = CollectNode(schedule, None if options.rearm is None else options.rearm == "auto")
        try:
            refuse_unknown_parameters(node)
            if node.meet():
                raise UserError("interrupted before anything was recorded")
            lost, broken = _record(node, schedule, _bench_of(node, bench), options)
        finally:
            node.leave()
            leave_graph(node)
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
    print(f"{options.out}: {node.playback.elapsed:.1f} s armed")
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
    options = parser.parse_args(own)
    if not (options.out or options.write_schedule):
        parser.error("give --out, --write-schedule, or both")
    return options
