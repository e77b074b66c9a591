# SPDX-License-Identifier: Apache-2.0
"""The node behind `collect`: plays a schedule into the plant that runs, and leaves it disarmed.

::

    meet     nobody else publishes gains; which box is it, and may it be armed without a person (simulation, emulator)?
    drive    arm, play, arm anew after a trip; too many trips in a row are the end
    leave    reference 0 N, and a disarm that the plant confirms
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future

from hydro_bridge.console import UserError, progress
from hydro_bridge.known_box import KnownBox
from hydro_bridge.ros import (
    BOX_WITHIN,
    DIAGNOSTICS,
    DIAGNOSTICS_QOS,
    GAINS,
    GAINS_QOS,
    NO_BOX,
    REFERENCE,
    REFERENCE_QOS,
    STATE,
    STATE_QOS,
    Companion,
    listen_to_box,
    reference_to_message,
    rivals,
    spin,
)
from hydro_bridge.signals import Flag
from hydro_bridge.signals import ReferenceSignal as Signal
from hydro_msgs.msg import BenchState, Gains, ReferenceSignal
from hydro_sim.box import EMULATED_BOX
from hydro_sim.learned.playback import Playback
from hydro_sim.nodes.arming import Arming, tell
from hydro_sim.schedules import Segment

TRIPS_IN_A_ROW = 3
_PERIOD = 0.01  # s, of gains
_REST = 1.0  # s recorded before arming: the still bench
_LOOK = 1.0  # s from the first sample on, in which others who publish gains are found
_PATIENCE = 8.0  # s without a sample: to say so


class CollectNode(Node):
    """Call `meet`, then `drive`, and `leave` whatever happens.

    Parameters
    ----------
    schedule
        What is played.
    rearm
        Whether the plant may be armed without a person; None: if it is the simulation or the emulator.
    """

    def __init__(self, schedule: Sequence[Segment], rearm: bool | None) -> None:
        super().__init__("collect")
        self.plant = ""
        """What runs, once it is met: sim, or what the box calls itself; empty if nobody says."""
        self.ended = ""
        """Why it ended before the schedule did, if it did by itself."""
        self.playback = Playback(schedule)
        self._rearm = rearm
        self.box: KnownBox | None = None
        """What the plant says of its box: schedules ask for gains in all, and a box takes changes to its own."""
        self._heard, self._started = inf, time.monotonic()
        self._met, self._finished, self._driving = Future(), Future(), False
        self._recorder: Companion | None = None
        self._bag, self._recorded_since = Path("nowhere"), inf
        self._gains = Gains()
        self._bar: Any = None
        self._gains_publisher = self.create_publisher(Gains, GAINS, GAINS_QOS)
        self._reference_publisher = self.create_publisher(ReferenceSignal, REFERENCE, REFERENCE_QOS)
        self._arming = Arming(self)
        self.create_subscription(BenchState, STATE, self._on_state, STATE_QOS)
        listen_to_box(self, self._on_box)
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, DIAGNOSTICS_QOS)
        self.create_timer(_PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def meet(self) -> bool:
        """Wait for a plant and look around; whether a signal ended it.

        Raises
        ------
        UserError
            Another node publishes gains, or nobody says what the box is.
        """
        broken = spin(self, self._met)
        if not broken and self.ended:
            raise UserError(self.ended)
        return broken

    def drive(self, recorder: Companion, bag: Path) -> bool:
        """Play once the recorder says that it has samples in `bag`, while it runs; whether a signal ended it."""
        self._recorder, self._bag, self._driving = recorder, bag, True
        self._bar = progress(total=round(self.playback.seconds), label="collecting", unit="s")
        self._arming.begin(rearm=bool(self._rearm))
        return spin(self, self._finished)

    def leave(self) -> None:
        """Leave the plant disarmed, with a reference of 0 N for who arms it next; not one that was never driven."""
        with _undisturbed():
            if self._bar is not None:
                self._bar.close()
            if not self._driving:
                return
            self._driving = False
            self._reference_publisher.publish(reference_to_message(Signal()))
            if not self._arming.disarm():
                tell("! the plant did not confirm that it is disarmed; its own watchdog remains")

    def _on_state(self, message: BenchState) -> None:
        self._heard = min(self._heard, time.monotonic())
        self.playback.on_sample(message.flags)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            if values.get("folder") == str(self._bag) and values.get(STATE, "0") != "0":
                self._recorded_since = min(self._recorded_since, time.monotonic())

    def _on_timer(self) -> None:
        if self._driving:
            self._drive_on()
        elif not self._met.done():
            self._look_around(time.monotonic())

    def _look_around(self, now: float) -> None:
        if self._heard == inf and now - self._started > _PATIENCE:
            self._started = inf
            tell(f"! no samples on {STATE} yet: start a bridge or a simulation")
        if now - self._heard < _LOOK:
            return
        self.ended = rivals(self, GAINS)
        if self.box is None and not self.ended:
            if now - self._heard < BOX_WITHIN:
                return
            self.ended = NO_BOX
        if self._rearm is None:
            self._rearm = self.plant in ("sim", EMULATED_BOX)
        self._met.set_result(None)

    def _on_box(self, box: KnownBox) -> None:
        if self._driving and self.box is not None and box.base_gains != self.box.base_gains:
            self._end("another box with other base gains has been connected: it is left disarmed")
        self.box, self.plant = box, "sim" if box.plant == "sim" else box.info.name

    def _drive_on(self) -> None:
        now = time.monotonic()
        if self._finished.done():
            return
        if self._recorder is None or not self._recorder.running:  # nothing moves unrecorded
            self._end("")
            return
        if now - self._recorded_since < _REST:
            return
        self._follow_schedule()
        self._follow_arming(now)
        self._gains.header.stamp = self.get_clock().now().to_msg()
        self._gains_publisher.publish(self._gains)

    def _follow_schedule(self) -> None:
        segment, playback = self.playback.next(), self.playback
        if playback.trips_in_a_row >= TRIPS_IN_A_ROW:
            self._end(f"the plant tripped {playback.trips_in_a_row} times in a row: it is left disarmed")
        elif playback.finished:
            self._end("")
        if segment is not None and self.box is not None:
            self._reference_publisher.publish(reference_to_message(segment.signal))
            self._gains.delta_kp = segment.kp - self.box.info.base_kp
            self._gains.delta_ki = segment.ki - self.box.info.base_ki
        if self._bar is not None:
            self._bar.update(int(playback.elapsed) - self._bar.n)

    def _follow_arming(self, now: float) -> None:
        if self._finished.done() or self.playback.flags & Flag.ARMED:
            self._arming.rest()
        elif trouble := rivals(self, GAINS):
            self._end(f"{trouble}; the plant is left disarmed")
        else:
            self._arming.seek(tripped=bool(self.playback.flags & Flag.TRIPPED), now=now)

    def _end(self, why: str) -> None:
        if not self._finished.done():
            self.ended = why
            self._finished.set_result(None)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """A second Ctrl-C waits until the plant is disarmed."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
