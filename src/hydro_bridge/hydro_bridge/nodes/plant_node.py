# SPDX-License-Identifier: Apache-2.0
"""ROS interface of every plant: the bridge's serial line and the simulation use the same node.

::

    /hydro/gains, /hydro/law, /hydro/correction, /hydro/reference ──> guard ─┐
    /hydro/claim, /hydro/arm ─────────────────────────────────────> gate     ├─ PlantSide (serial line, simulation)
    /hydro/state, /hydro/law_state, /hydro/box, /hydro/box_law <── publish_… ──┘

The gate decides whose commands are accepted. While two nodes publish one of these topics the status is ERROR, nothing
can be armed, and an armed plant is disarmed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from hydro_bridge.nodes.gate import Gate, PlantSide
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status, with_publisher_conflicts
from hydro_bridge.ros.messages import (
    CORRECTIONS,
    STATES,
    box_to_message,
    law_command_from_message,
    law_to_message,
    pack_law_state,
    reference_from_message,
    subscribe,
)
from hydro_bridge.ros.topics import (
    BOX,
    BOX_LAW,
    CORRECTION,
    GAINS,
    LAW,
    LAW_STATE,
    REFERENCE,
    STATE,
    create_publisher,
    create_subscription,
)
from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.serial.frames import BoxLaw, LawState
from hydro_bridge.signals import Flag, Law, flag_names
from hydro_msgs.msg import Gains, LawCommand, ReferenceSignal


class PlantNode(Node):
    """Publishes state and box, and its force law; receives gains, law, corrections, reference and arming.

    Call `connect` once the plant's side exists; nothing is subscribed before.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._publisher = create_publisher(self, STATE)
        self._law_publisher = create_publisher(self, LAW_STATE)
        self._box_publisher = create_publisher(self, BOX)
        self._box_law_publisher = create_publisher(self, BOX_LAW)
        self._flags, self._tripped = 0, False
        self._beside_another = False

    def connect(self, side: PlantSide, clock: Callable[[], float] = time.monotonic) -> None:
        """Accept commands for `side`, and report its status; `clock` is the guard's [s]."""
        self.side, self._now = side, clock
        limits = side.guard.settings
        self.get_logger().info(
            f"guard: delta_kp within [{limits.delta_kp_min:g}, {limits.delta_kp_max:g}] 1/s, delta_ki within "
            f"[{limits.delta_ki_min:g}, {limits.delta_ki_max:g}] 1/s^2, relying on {limits.relies_on}"
        )
        self.gate = Gate(self, side, lambda: bool(self._flags & Flag.TRIPPED))
        gains = create_subscription(self, GAINS, self._on_gains)
        correction = subscribe(self, CORRECTION, CORRECTIONS, self._on_correction)
        reference = create_subscription(self, REFERENCE, self._on_reference)
        law = create_subscription(self, LAW, self._on_law)
        for topic, heard in ((GAINS, gains), (CORRECTION, correction), (REFERENCE, reference), (LAW, law)):
            self.gate.listen(topic, heard)  # no callback runs before the node is spun
        self.create_timer(0.1, self._tell_events, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = DiagnosticsPublisher(self, self._status)

    def publish_state(self, stamp_ns: int, sequence: int, values: Sequence[float], flags: int) -> None:
        """Publish one sample; `values` in STATE_FIELDS order. Call from the plant's thread only."""
        self._flags = flags
        self._publisher.publish(STATES.pack(stamp_ns, sequence, *values, flags))

    def publish_law_state(self, stamp_ns: int, sequence: int, state: LawState | None) -> None:
        """Publish the force law of a sample, before the sample itself; the paper's law is not worth a message."""
        if state is not None and state.law is not Law.PAPER:
            self._law_publisher.publish(pack_law_state(stamp_ns, sequence, state))

    def publish_box(self, box: KnownBox, law: BoxLaw | None) -> None:
        """Publish the box's identity, assumed bench and compensated law, None: it has none, and offer it to the guard.

        At the start, and whenever it may be another box.
        """
        with self.side.lock:
            self.side.guard.offer(law)
        now = self.get_clock().now().to_msg()
        self._box_law_publisher.publish(law_to_message(law, now))
        self._box_publisher.publish(box_to_message(box, now))

    def gained(self) -> None:
        """Hook, called when gains have been accepted."""

    def _on_gains(self, message: Gains) -> None:
        if not self.gate.admits(GAINS, message.epoch):
            return
        with self.side.lock:
            self.side.guard.set_gains(message.delta_kp, message.delta_ki, self._now())
        self.gained()

    def _on_law(self, message: LawCommand) -> None:
        if not self.gate.admits(LAW, message.epoch):
            return
        wanted = law_command_from_message(message)
        if wanted is None:
            self.get_logger().warning(f"unknown force law {message.law}: refused", throttle_duration_sec=5.0)
            return
        with self.side.lock:
            self.side.guard.set_law(wanted, self._now())

    def _on_correction(self, message: Any) -> None:
        if not self.gate.admits(CORRECTION, message.epoch):
            return
        with self.side.lock:
            self.side.guard.set_correction(message.delta_u, message.status, message.sequence, self._now())
        self.side.send(message.sequence)

    def _on_reference(self, message: ReferenceSignal) -> None:
        if not self.gate.admits(REFERENCE, message.epoch):
            return
        signal = reference_from_message(message)
        if signal is None:
            self.get_logger().warning(f"reference refused, the last one is kept: unknown waveform {message.waveform}")
            return
        with self.side.lock:
            self.side.guard.set_reference(signal)

    def _status(self) -> Status:
        status, given_up = self.side.status(), self.side.guard.given_up
        if given_up:
            message = f"{status.message}: {given_up}"
            status = replace(status, level=max(status.level, Level.WARN), message=message)
        status = replace(status, values={**status.values, **self.gate.values()})
        if self.count_publishers(STATE) > 1 and not self._beside_another:
            self.get_logger().error("two plants publish /hydro/state, so nothing can be armed: stop one of them")
        self._beside_another = self.count_publishers(STATE) > 1
        return with_publisher_conflicts(status, self.gate.crowd())

    def _tell_events(self) -> None:
        with self.side.lock:
            events = self.side.guard.take_events()
        for event, trouble in events.items():
            if trouble:
                self.get_logger().warning(event)
            else:
                self.get_logger().info(event)
        flags, before = self._flags, self._tripped
        self._tripped = bool(flags & Flag.TRIPPED)
        if self._tripped and not before:
            self.get_logger().warning(
                f"the box tripped ({flag_names(flags)}) and closed the valve: find the cause, disarm it, then arm it"
            )
