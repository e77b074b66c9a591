# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and plain types. Message objects are reused, since conversions run at 1 kHz."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from hydro_bridge.ros.topics import BOX, create_subscription
from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.serial.frames import BoxInfo, BoxLaw, LawState
from hydro_bridge.signals import STATE_FIELDS, Law, LawCommand, ReferenceSignal, Waveform
from hydro_msgs.msg import BenchState
from hydro_msgs.msg import BoxInfo as BoxMessage
from hydro_msgs.msg import BoxLaw as BoxLawMessage
from hydro_msgs.msg import LawCommand as LawCommandMessage
from hydro_msgs.msg import LawState as LawStateMessage
from hydro_msgs.msg import ReferenceSignal as ReferenceMessage


class StateMessage:
    """A reusable BenchState message, refilled for each sample.

    Filling and publishing takes some 5 us; a new message object for each sample would take half as much again.
    """

    def __init__(self) -> None:
        self.message = BenchState()
        self.message.header.frame_id = "bench"

    def fill(self, stamp_ns: int, sequence: int, values: Sequence[float], flags: int) -> BenchState:
        """Return the message, valid until the next call; `values` in STATE_FIELDS order, shape (14,)."""
        message = self.message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        message.sequence = sequence
        for name, value in zip(STATE_FIELDS, values, strict=True):
            setattr(message, name, value)
        message.flags = flags
        return message


def state_from_message(message: BenchState) -> tuple[float, ...]:
    """Return the floats of a BenchState in STATE_FIELDS order, shape (14,)."""
    return tuple(getattr(message, name) for name in STATE_FIELDS)


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def reference_from_message(message: ReferenceMessage) -> ReferenceSignal | None:
    """Return the plain reference; None for an unknown waveform."""
    if message.waveform not in tuple(Waveform):
        return None
    return ReferenceSignal(
        waveform=Waveform(message.waveform),
        amplitude=message.amplitude,
        offset=message.offset,
        frequency=message.frequency,
        phase=message.phase,
    )


def reference_to_message(signal: ReferenceSignal, epoch: int = 0) -> ReferenceMessage:
    """Return the message of a plain reference; `epoch` is that of the session."""
    return ReferenceMessage(
        waveform=int(signal.waveform),
        amplitude=float(signal.amplitude),
        offset=float(signal.offset),
        frequency=float(signal.frequency),
        phase=float(signal.phase),
        epoch=epoch,
    )


_NUMBERS = tuple(entry.name for entry in fields(BoxInfo) if isinstance(entry.default, float))


def box_to_message(box: KnownBox, stamp: Any) -> BoxMessage:
    """Return the message that describes a box; `stamp` is a builtin_interfaces/Time."""
    numbers = {name: float(getattr(box.info, name)) for name in _NUMBERS}
    texts = {name: getattr(box, name) for name in ("plant", "bench_digest", "bench", "integral")}
    message = BoxMessage(firmware=box.info.name, **texts, **numbers)
    message.header.stamp = stamp
    return message


def box_from_message(message: BoxMessage) -> KnownBox:
    """Return a box's description from its message."""
    numbers = {name: getattr(message, name) for name in _NUMBERS}
    info = BoxInfo(name=message.firmware, integral=message.integral, **numbers)
    texts = {name: getattr(message, name) for name in ("plant", "bench_digest", "bench")}
    return KnownBox(info=info, **texts)


_LAW_NUMBERS = tuple(entry.name for entry in fields(BoxLaw))


def law_to_message(law: BoxLaw | None, stamp: Any) -> BoxLawMessage:
    """Return the message of a box's compensated law, None: it has none; `stamp` is a builtin_interfaces/Time."""
    numbers = {} if law is None else {name: getattr(law, name) for name in _LAW_NUMBERS}
    message = BoxLawMessage(offered=law is not None, **numbers)
    message.header.stamp = stamp
    return message


def law_from_message(message: BoxLawMessage) -> BoxLaw | None:
    """Return a box's compensated law from its message; None: it has none."""
    if not message.offered:
        return None
    told = {name: getattr(message, name) for name in _LAW_NUMBERS}
    numbers: dict[str, Any] = {
        name: value if isinstance(value, float) else tuple(value) for name, value in told.items()
    }
    return BoxLaw(**numbers)


def fill_law_command(message: LawCommandMessage, command: LawCommand) -> LawCommandMessage:
    """Write a command into a message, all but its stamp, step and epoch; returns it."""
    message.law = int(command.law)
    message.a_0, message.a_1, message.a_2, message.a_3 = command.coefficients
    message.velocity_compensation = command.velocity_compensation
    message.valve_gain_scale = command.valve_gain_scale
    return message


def law_command_from_message(message: LawCommandMessage) -> LawCommand | None:
    """Return the plain command of a force law; None for an unknown law."""
    if message.law not in tuple(Law):
        return None
    return LawCommand(
        law=Law(message.law),
        coefficients=(message.a_0, message.a_1, message.a_2, message.a_3),
        velocity_compensation=message.velocity_compensation,
        valve_gain_scale=message.valve_gain_scale,
    )


def fill_law_state(message: LawStateMessage, stamp_ns: int, sequence: int, state: LawState) -> LawStateMessage:
    """Write the force law of sample `sequence` into a message, which runs at 1 kHz; returns it."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    message.sequence, message.law = sequence, int(state.law)
    message.compensated_reference = state.compensated_reference
    message.compensated_reference_rate = state.compensated_reference_rate
    message.a_0, message.a_1, message.a_2, message.a_3 = state.coefficients
    message.velocity_compensation, message.valve_gain_scale = state.velocity_compensation, state.valve_gain_scale
    return message


def law_state_from_message(message: LawStateMessage) -> LawState:
    """Return the force law of a sample (raises ValueError for an unknown law)."""
    followed = message.compensated_reference, message.compensated_reference_rate
    coefficients = message.a_0, message.a_1, message.a_2, message.a_3
    return LawState(Law(message.law), *followed, coefficients, message.velocity_compensation, message.valve_gain_scale)


def subscribe_to_box(node: Node, on_box: Callable[[KnownBox], None]) -> Subscription:
    """Call `on_box` with the box's description as soon as the plant node is discovered, and at each change."""
    return create_subscription(node, BOX, lambda message: on_box(box_from_message(message)))
