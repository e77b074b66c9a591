# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and plain types. Message objects are reused, since conversions run at 1 kHz."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from hydro_bridge.safety.box_info import KnownBox
from hydro_bridge.serial.frames import BoxInfo
from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, Waveform
from hydro_msgs.msg import BenchState
from hydro_msgs.msg import BoxInfo as BoxMessage
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
