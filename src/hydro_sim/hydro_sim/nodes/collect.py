# SPDX-License-Identifier: Apache-2.0
"""Plays a random schedule of references and gains into the graph, and has it recorded: what a model is trained on.

ros2 run hydro_sim collect --out BAG [--seconds S] [--seed N] [--schedule FILE] [--ros-args ...]
ros2 run hydro_sim collect --write-schedule FILE [--seconds S] [--seed N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool
from tqdm import tqdm

from hydro_bridge.console import UserError, add_json_argument, command, progress, writable, writable_folder
from hydro_bridge.recording import read_bag
from hydro_bridge.ros import (
    ARM_SERVICE,
    GAINS,
    GAINS_QOS,
    REFERENCE,
    REFERENCE_QOS,
    STATE,
    STATE_QOS,
    Companion,
    CompanionError,
    reference_to_message,
    ros_arguments,
    spin,
    start_ros,
)  # fmt: skip
from hydro_bridge.signals import Flag
from hydro_msgs.msg import BenchState, Gains, ReferenceSignal
from hydro_sim.box import BoxConfig
from hydro_sim.learned.coverage import coverage
from hydro_sim.learned.schedule import Stretch, draw, load, save

PERIOD = 0.01  # s, of gains
REST = 1.0  # s recorded before arming: the still bench


class CollectNode(Node):
    """One stretch of the schedule after the other, by the plant's own samples; re-arms after a trip.

    Finished, too, when the recorder has ended: nothing moves unrecorded.
    """

    def __init__(self, schedule: Sequence[Stretch], recorder: Companion) -> None:
        super().__init__("collect")
        self._schedule, self._recorder = list(schedule), recorder
        self._box = BoxConfig()
        self._ends = [sum(stretch.seconds for stretch in schedule[: k + 1]) for k in range(len(schedule))]
        self._index, self._elapsed, self._flags, self._seen = -1, 0.0, Flag(0), False
        self._answer: Future | None = None
        self._arm_wanted, self._began = False, time.monotonic()
        self._gains = Gains()
        self._gains_publisher = self.create_publisher(Gains, GAINS, GAINS_QOS)
        self._reference_publisher = self.create_publisher(ReferenceSignal, REFERENCE, REFERENCE_QOS)
        self._client = self.create_client(SetBool, ARM_SERVICE)
        self.trips, self.finished = 0, Future()
        self._bar: tqdm[Any] = progress(total=round(self._ends[-1]), label="collecting", unit="s")
        self.create_subscription(BenchState, STATE, self._on_state, STATE_QOS)
        self.create_timer(PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Leave the plant disarmed."""
        self._bar.close()
        self._ask(False)
        time.sleep(0.1)

    def _on_state(self, message: BenchState) -> None:
        self._seen, self._flags = True, Flag(message.flags)
        if self._flags & Flag.ARMED:
            self._elapsed += 1e-3

    def _on_timer(self) -> None:
        if self.finished.done():
            return
        if not self._recorder.running:
            self.finished.set_result(None)
            return
        if not self._seen or self.count_subscribers(STATE) < 2:  # the recorder is another one
            self._began = time.monotonic()
        if time.monotonic() - self._began < REST:
            return
        self._follow_arming()
        self._follow_schedule()
        self._gains.header.stamp = self.get_clock().now().to_msg()
        self._gains_publisher.publish(self._gains)
        self._bar.update(int(self._elapsed) - self._bar.n)

    def _follow_arming(self) -> None:
        """Arm; after a trip disarm, then arm anew. One request at a time."""
        if self._answer is not None and not self._answer.done():
            return
        if self._flags & Flag.TRIPPED:
            self.trips += self._arm_wanted
            self._ask(False)
        elif not self._flags & Flag.ARMED:
            self._ask(True)

    def _ask(self, arm: bool) -> None:
        if self._client.service_is_ready():
            self._arm_wanted = arm
            self._answer = self._client.call_async(SetBool.Request(data=arm))

    def _follow_schedule(self) -> None:
        index = max(self._index, 0)
        while index < len(self._ends) and self._elapsed >= self._ends[index]:
            index += 1
        if index == len(self._ends):
            self.finished.set_result(None)
            return
        if index != self._index:
            self._index, stretch = index, self._schedule[index]
            self._reference_publisher.publish(reference_to_message(stretch.signal))
            self._gains.delta_kp = stretch.kp - self._box.base_kp
            self._gains.delta_ki = stretch.ki - self._box.base_ki


def _play(schedule: Sequence[Stretch], out: Path, ros: Sequence[str]) -> None:
    """Record while the schedule plays; raises UserError if it was broken off."""
    start_ros(ros)
    topics = ["--topics", STATE, GAINS, REFERENCE]
    try:
        with Companion("hydro_bridge", "recorder", ["--out", str(out), *topics]) as recorder:
            node = CollectNode(schedule, recorder)
            broken = spin(node, node.finished)
            lost = _why_ended(recorder, out)
            node.close()
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    if node.trips:
        print(f"the plant tripped {node.trips} times; the schedule went on after it was armed anew")
    if lost:
        raise UserError(f"nothing records any more: {lost}")
    if broken:
        raise UserError(f"broken off: {out} holds what was played so far")


def _why_ended(recorder: Companion, out: Path) -> str:
    """Why nothing records any more; empty as long as something does."""
    if recorder.running:
        return ""
    if recorder.process.returncode == 2:  # it could not use `out`
        return recorder.last_words.removeprefix("error: ")
    return f"the recorder ended (exit status {recorder.process.returncode}); {out} holds what came before"


@command(ValueError, OSError, CompanionError)
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    options = _arguments(own)
    schedule = load(options.schedule) if options.schedule else draw(options.seconds, options.seed)
    if options.write_schedule:
        save(schedule, options.write_schedule)
        print(f"{options.write_schedule}: {len(schedule)} stretches, {sum(s.seconds for s in schedule):g} s")
    if options.out:
        _play(schedule, options.out, ros)
        coverage(read_bag(options.out).state).show(options.json)


def _arguments(own: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="collect", description="Record random references and gains for training.")
    parser.add_argument("--out", type=writable_folder, metavar="BAG", help="recording to make")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the schedule")
    parser.add_argument("--seed", type=int, default=1, help="of the schedule")
    parser.add_argument("--schedule", metavar="FILE", help="play this one instead of drawing one")
    parser.add_argument(
        "--write-schedule", type=writable, metavar="FILE", help="write the schedule, for instance for the emulator"
    )
    add_json_argument(parser)
    options = parser.parse_args(own)
    if not 1.0 <= options.seconds <= 36000.0:
        parser.error(f"--seconds {options.seconds:g}: 1 to 36000 is meant")
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: 0 or more is meant")
    if not (options.out or options.write_schedule):
        parser.error("say where to: --out, --write-schedule, or both")
    return options
