# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages and plain types.

Messages at the sample rate are packed and unpacked as bytes by `Codec`, without message objects.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import fields
from struct import Struct
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from hydro_bridge.ros.topics import BOX, RECORDED_TOPICS, create_subscription
from hydro_bridge.safety.box_info import BoxDescription
from hydro_bridge.serial.protocol import BoxInfo, BoxLaw, LawState
from hydro_core.signals import Law, LawCommand, ReferenceSignal, Waveform
from hydro_msgs import msg

FRAME_ID = "bench"
_FORMAT_CODES = {"boolean": "?", "uint8": "B", "uint32": "I", "uint64": "Q", "double": "d"}


class Codec:
    """Codec of serialized messages (CDR) with a header and numbers only, in a tenth of rosidl's time.

    `kind`: message class. A record has the message's fields, and `stamp` [ns] in place of its header. Messages of
    another byte order or `frame_id` are unpacked by rosidl.
    """

    def __init__(self, kind: type[Any]) -> None:
        _, *members = kind.get_fields_and_field_types().items()
        self.kind, self._names = kind, [name for name, _ in members]
        self.record: Callable[..., Any] = namedtuple(kind.__name__, ("stamp", *self._names))  # type: ignore[misc]
        frame = FRAME_ID.encode() + b"\0"
        form, place = f"{len(frame)}s", 12 + len(frame)  # behind sec, nanosec and the size of frame_id
        for _, name in members:
            code = _FORMAT_CODES[name]
            gap = -place % (size := Struct("<" + code).size)
            form, place = f"{form}{gap}x{code}", place + gap + size
        self._head = b"\0\1\0\0", len(frame), frame
        self._struct = Struct(f"<4siII{form}")

    def pack(self, stamp: int, *numbers: float) -> bytes:
        """Return the serialized message; `stamp` in ns, `numbers` in the message's order."""
        head, size, frame = self._head
        return self._struct.pack(head, *divmod(stamp, 1_000_000_000), size, frame, *numbers)

    def unpack(self, data: bytes) -> Any:
        """Return the record of a serialized message; None: it is none of this type."""
        if len(data) >= self._struct.size:
            head, sec, nanosec, size, frame, *numbers = self._struct.unpack_from(data)
            if (head, size, frame) == self._head:
                return self.record(1_000_000_000 * sec + nanosec, *numbers)
        try:
            message = deserialize_message(data, self.kind)
        except RuntimeError:  # base class of all errors of rclpy
            return None
        stamp = message.header.stamp
        numbers = [getattr(message, name) for name in self._names]
        return self.record(1_000_000_000 * stamp.sec + stamp.nanosec, *numbers)


STATE_CODEC, CORRECTION_CODEC, LAW_STATE_CODEC = Codec(msg.BenchState), Codec(msg.Correction), Codec(msg.LawState)


def subscribe(node: Node, topic: str, codec: Codec, callback: Callable[[Any], None]) -> Subscription:
    """Call `callback` with the record of each message of one of `RECORDED_TOPICS`; malformed messages are dropped."""

    def take(data: bytes) -> None:
        if (record := codec.unpack(data)) is not None:
            callback(record)

    return node.create_subscription(codec.kind, topic, take, RECORDED_TOPICS[topic][1], raw=True)


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


_SIGNAL_FIELDS = ("amplitude", "offset", "frequency", "phase")


def reference_from_message(message: msg.ReferenceSignal) -> ReferenceSignal | None:
    """Return a message's `ReferenceSignal`; None for an unknown waveform."""
    if message.waveform not in tuple(Waveform):
        return None
    return ReferenceSignal(
        waveform=Waveform(message.waveform), **{name: getattr(message, name) for name in _SIGNAL_FIELDS}
    )


def reference_to_message(signal: ReferenceSignal, epoch: int = 0) -> msg.ReferenceSignal:
    """Return the message of a reference; `epoch` is that of the session."""
    numbers = {name: float(getattr(signal, name)) for name in _SIGNAL_FIELDS}
    return msg.ReferenceSignal(waveform=int(signal.waveform), epoch=epoch, **numbers)


_NUMBER_FIELDS = tuple(entry.name for entry in fields(BoxInfo) if isinstance(entry.default, float))
_TEXT_FIELDS = ("plant", "bench_digest", "bench")


def box_to_message(box: BoxDescription, stamp: Any) -> msg.BoxInfo:
    """Return the message that describes a box; `stamp` is a builtin_interfaces/Time."""
    values = {name: float(getattr(box.info, name)) for name in _NUMBER_FIELDS} | {
        name: getattr(box, name) for name in _TEXT_FIELDS
    }
    message = msg.BoxInfo(firmware=box.info.name, integral=box.info.integral, **values)
    message.header.stamp = stamp
    return message


def law_to_message(law: BoxLaw | None, stamp: Any) -> msg.BoxLaw:
    """Return the message of a box's compensated law, None: it has none; `stamp` is a builtin_interfaces/Time."""
    message = msg.BoxLaw(offered=law is not None, **({} if law is None else vars(law)))
    message.header.stamp = stamp
    return message


def law_command_from_message(message: msg.LawCommand) -> LawCommand | None:
    """Return a message's `LawCommand`; None for an unknown law."""
    if message.law not in tuple(Law):
        return None
    return LawCommand(
        law=Law(message.law),
        coefficients=(message.a_0, message.a_1, message.a_2, message.a_3, message.a_4),
        velocity_compensation=message.velocity_compensation,
        valve_gain_scale=message.valve_gain_scale,
    )


def pack_law_state(stamp: int, sequence: int, state: LawState) -> bytes:
    """Return the serialized LawState of sample `sequence`; `stamp` in ns."""
    followed = state.compensated_reference, state.compensated_reference_rate
    scales = state.velocity_compensation, state.valve_gain_scale
    return LAW_STATE_CODEC.pack(stamp, sequence, int(state.law), *followed, *state.coefficients, *scales)


def law_state_from_message(message: Any) -> LawState:
    """Return the law state of a sample from a LawState message or its record; raises ValueError for an unknown law."""
    followed = message.compensated_reference, message.compensated_reference_rate
    coefficients = message.a_0, message.a_1, message.a_2, message.a_3, message.a_4
    return LawState(Law(message.law), *followed, coefficients, message.velocity_compensation, message.valve_gain_scale)


def subscribe_to_box(node: Node, on_box: Callable[[BoxDescription], None]) -> Subscription:
    """Call `on_box` with the box's description as soon as the plant node is discovered, and at each change."""

    def take(message: msg.BoxInfo) -> None:
        numbers = {name: getattr(message, name) for name in _NUMBER_FIELDS}
        info = BoxInfo(name=message.firmware, integral=message.integral, **numbers)
        on_box(BoxDescription(info=info, **{name: getattr(message, name) for name in _TEXT_FIELDS}))

    return create_subscription(node, BOX, take)
