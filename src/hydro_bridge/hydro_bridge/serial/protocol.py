# SPDX-License-Identifier: Apache-2.0
"""Encoding and decoding of frames of the serial line; byte tables and rationale in protocol.md.

A frame on the wire, all little endian::

    0x00 | COBS( version u8 | type u8 | sequence u32 | time_us u64 | payload | CRC-32 u32 ) | 0x00

Delimiters on both sides let a frame after garbage be read completely: resynchronising loses nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, fields
from math import copysign, inf
from struct import Struct
from zlib import crc32

from cobs import cobs

from hydro_bridge.serial.frames import (
    FEEDBACKS,
    INTEGRAL_FORMS,
    VERSION,
    VERSION_MIN,
    BoxDetails,
    BoxInfo,
    CheckSumError,
    CommandFrame,
    Details,
    Frame,
    FrameType,
    Hello,
    MalformedError,
    State,
    UnknownFrameError,
    WrongVersionError,
)
from hydro_bridge.signals import STATE_FIELDS, Command, ReferenceSignal, Waveform

__all__ = [
    "HANDSHAKE",
    "MAX_ENCODED",
    "VERSION",
    "VERSION_MIN",
    "BoxDetails",
    "BoxInfo",
    "CheckSumError",
    "CommandFrame",
    "Details",
    "Frame",
    "FrameType",
    "Hello",
    "MalformedError",
    "State",
    "UnknownFrameError",
    "WrongVersionError",
    "decode",
    "encode_command",
    "encode_details",
    "encode_hello",
    "encode_state",
    "negotiate",
]

HANDSHAKE = 0
"""Version byte of HELLO frames: their layout is the same in all versions, so that any two ends can negotiate."""
MAX_ENCODED = 160
"""Maximum number of bytes between two delimiters; more is noise."""

_HEADER = Struct("<BBIQ")
_STATE = Struct(f"<BBIQ{len(STATE_FIELDS)}fII")
_STATE_2 = Struct(f"<BBIQ{len(STATE_FIELDS)}fIIII")
_COMMAND = Struct("<BBIQIIfffIffff")
_DETAILS = Struct("<BBIQI12sBBBB10f")
_HELLO = Struct("<BBIQBBBB32s9f")
_CRC = Struct("<I")
_ARM, _FILTER_FRESH = 1, 2


def encode_state(
    sequence: int,
    time_us: int,
    values: Sequence[float],
    flags: int,
    last_command: int,
    refused: tuple[int, int] | None = None,
) -> bytes:
    """Encode one sample: version 2 if it counts refusals, else version 1.

    Parameters
    ----------
    sequence
        Counts box samples, wraps at 2^32.
    time_us
        Box clock, microseconds.
    values
        Floats in STATE_FIELDS order, shape (14,); sent as float32, beyond its range as infinity.
    flags
        Bits of `signals.Flag`.
    last_command
        Sequence of the newest command received, 0 before the first; the host measures the round trip with it.
    refused
        Numbers of values and of references that the box refused since its power-on.
    """
    head = (VERSION_MIN if refused is None else 2, FrameType.STATE, sequence & 0xFFFFFFFF, time_us)
    layout, tail = (_STATE, ()) if refused is None else (_STATE_2, tuple(count & 0xFFFFFFFF for count in refused))
    try:
        return _wrap(layout.pack(*head, *values, flags, last_command, *tail))
    except OverflowError:
        return _wrap(layout.pack(*head, *map(_single, values), flags, last_command, *tail))


def encode_command(sequence: int, time_us: int, command: Command, version: int = VERSION_MIN) -> bytes:
    """Encode one command; `time_us` is the host's clock, `version` the one negotiated."""
    reference = command.reference
    bits = _ARM * command.arm | _FILTER_FRESH * command.filter_fresh
    numbers = (command.delta_kp, command.delta_ki, command.delta_u)
    shape = (reference.amplitude, reference.offset, reference.frequency, reference.phase)
    head = (version, FrameType.COMMAND, sequence & 0xFFFFFFFF, time_us, bits, command.corrects)
    try:
        return _wrap(_COMMAND.pack(*head, *numbers, reference.waveform, *shape))
    except OverflowError:
        return _wrap(_COMMAND.pack(*head, *map(_single, numbers), reference.waveform, *map(_single, shape)))


def encode_hello(sequence: int, time_us: int, info: BoxInfo | None = None) -> bytes:
    """Encode the frame that opens a connection; a box gives its `info`, the host none."""
    name, *numbers, integral = astuple(info) if info else ("", *(0.0,) * 9, "")
    who = (VERSION_MIN, VERSION, info is not None, INTEGRAL_FORMS.index(integral))
    head = (HANDSHAKE, FrameType.HELLO, sequence & 0xFFFFFFFF, time_us, *who)
    return _wrap(_HELLO.pack(*head, name.encode()[:32], *numbers))


def encode_details(sequence: int, time_us: int, details: BoxDetails) -> bytes:
    """Encode the frame that follows each HELLO of a box in version 2."""
    epoch, digest, feedback, *numbers = astuple(details)
    who = (epoch & 0xFFFFFFFF, digest.encode()[:12], FEEDBACKS.index(feedback), 0, 0, 0)
    return _wrap(_DETAILS.pack(2, FrameType.DETAILS, sequence & 0xFFFFFFFF, time_us, *who, *numbers))


def decode(encoded: bytes) -> Frame:
    """Decode the frame between two delimiters.

    Raises
    ------
    MalformedError
        Broken COBS, length or content; `CheckSumError`, `UnknownFrameError` and `WrongVersionError` are subclasses.
        Nothing else is ever raised.
    """
    try:
        raw = cobs.decode(encoded)
    except cobs.DecodeError as error:
        raise MalformedError(str(error)) from None
    body = raw[:-4]
    if raw[-4:] != _CRC.pack(crc32(body)):
        raise CheckSumError("check sum")
    if len(body) < _HEADER.size:
        raise MalformedError(f"{len(body)} bytes are too few for a header")
    version, kind = body[0], body[1]
    if version != HANDSHAKE if kind == FrameType.HELLO else not VERSION_MIN <= version <= VERSION:
        raise WrongVersionError(version)
    layout, unpack = _LAYOUTS.get((version, kind), (None, None))
    if layout is None or unpack is None:
        raise UnknownFrameError(f"frame type {kind}")
    if len(body) != layout.size:
        raise MalformedError(f"{len(body)} bytes in a {FrameType(kind).name} frame, expected {layout.size}")
    return unpack(layout.unpack(body))


def negotiate(hello: Hello) -> int:
    """Return the highest protocol version that both ends support.

    Raises
    ------
    WrongVersionError
        There is none; the message names the versions of each end.
    """
    if hello.version_min <= VERSION and hello.version_max >= VERSION_MIN:
        return min(VERSION, hello.version_max)
    raise WrongVersionError(hello.version_max)


def _wrap(body: bytes) -> bytes:
    stuffed: bytes = cobs.encode(body + _CRC.pack(crc32(body)))
    return b"\0" + stuffed + b"\0"


def _single(value: float) -> float:
    """Return the nearest float that fits into float32."""
    return copysign(inf, value) if abs(value) > 3.4028234e38 else value


def _state(values: tuple[float, ...]) -> State:
    return State(int(values[2]), int(values[3]), values[4:18], *map(int, values[18:]))


def _details(values: tuple[float, ...]) -> Details:
    _, _, sequence, time_us, epoch, digest, feedback, _, _, _, *numbers = values
    text = bytes(digest).rstrip(b"\0").decode(errors="replace")  # type: ignore[call-overload]
    force = FEEDBACKS[int(feedback)] if feedback < len(FEEDBACKS) else ""
    names = [entry.name for entry in fields(BoxDetails)][3:]
    details = BoxDetails(
        epoch=int(epoch), bench_digest=text, feedback=force, **dict(zip(names, numbers, strict=True))
    )  # fmt: skip
    return Details(int(sequence), int(time_us), details)


def _command(values: tuple[float, ...]) -> CommandFrame:
    (bits, corrects, delta_kp, delta_ki, delta_u, waveform, amplitude, offset, frequency, phase) = values[4:]
    if waveform > Waveform.SMOOTH_STEP:
        raise MalformedError(f"waveform {waveform}")
    reference = ReferenceSignal(
        waveform=Waveform(int(waveform)), amplitude=amplitude, offset=offset, frequency=frequency, phase=phase
    )
    command = Command(
        arm=bool(int(bits) & _ARM),
        delta_kp=delta_kp,
        delta_ki=delta_ki,
        delta_u=delta_u,
        reference=reference,
        corrects=int(corrects),
        filter_fresh=bool(int(bits) & _FILTER_FRESH),
    )
    return CommandFrame(int(values[2]), int(values[3]), command)


def _hello(values: tuple[float, ...]) -> Hello:
    _, _, sequence, time_us, version_min, version_max, is_box, form, name, *numbers = values
    text = bytes(name).rstrip(b"\0").decode(errors="replace")  # type: ignore[call-overload]
    integral = INTEGRAL_FORMS[int(form)] if form < len(INTEGRAL_FORMS) else ""
    names = tuple(BoxInfo.__dataclass_fields__)[1:-1]
    info = BoxInfo(name=text, integral=integral, **dict(zip(names, numbers, strict=True))) if is_box else None
    return Hello(int(sequence), int(time_us), int(version_min), int(version_max), info)


_LAYOUTS: dict[tuple[int, int], tuple[Struct, Callable[[tuple[float, ...]], Frame]]] = {
    (HANDSHAKE, FrameType.HELLO): (_HELLO, _hello),
    (1, FrameType.STATE): (_STATE, _state),
    (1, FrameType.COMMAND): (_COMMAND, _command),
    (2, FrameType.STATE): (_STATE_2, _state),
    (2, FrameType.COMMAND): (_COMMAND, _command),
    (2, FrameType.DETAILS): (_DETAILS, _details),
}
