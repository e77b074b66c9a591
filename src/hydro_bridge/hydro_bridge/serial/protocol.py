# SPDX-License-Identifier: Apache-2.0
"""Frames of the serial line, their encoding and decoding; byte tables and rationale in protocol.md.

A frame on the wire, all little endian::

    0x00 | COBS( version u8 | type u8 | sequence u32 | time_us u64 | payload | CRC-32 u32 ) | 0x00

Delimiters on both sides let a frame after garbage be read completely: resynchronising loses nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields, replace
from enum import IntEnum
from math import copysign, inf
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from cobs import cobs

from hydro_core.signals import (
    NEUTRAL_COEFFICIENTS,
    STATE_FIELDS,
    Command,
    Law,
    ReferenceCoefficients,
    ReferenceSignal,
    Waveform,
)

VERSION = 4
"""Protocol version of all frames but HELLO; frames of other versions are rejected."""


class FrameType(IntEnum):
    """Frame types, the second byte of a frame."""

    HELLO = 1
    STATE = 2
    COMMAND = 3
    DETAILS = 4
    LAW = 5
    CLOCK = 128
    """From an emulator only, before its answer to a HELLO: its clock is not the host's."""


class MalformedError(ValueError):
    """A frame with a valid check sum whose content does not follow its layout in protocol.md."""


class CheckSumError(MalformedError):
    """A frame whose CRC-32 does not match."""


class UnknownFrameError(MalformedError):
    """An unknown frame type of this protocol version: skipped, so that newer boxes may add types."""


class WrongVersionError(MalformedError):
    """A frame of another version, given by `version`."""

    def __init__(self, version: int) -> None:
        super().__init__(f"frame of version {version}, here version {VERSION} is spoken")
        self.version = version


INTEGRAL_FORMS = ("", "paper", "bumpless")
"""Forms of the force law's integral by their number in HELLO: not reported, K_i int e dt, int K_i e dt."""


@dataclass(frozen=True, kw_only=True)
class BoxInfo:
    """A box's HELLO: identity, base gains, and limits that the bridge never exceeds."""

    name: str = ""
    """Firmware and its version, at most 32 bytes of UTF-8."""
    valve_current_max: float = 0.05
    """A."""
    base_kp: float = 15.0
    """1/s, proportional gain to which `delta_kp` is added."""
    base_ki: float = 5.0
    """1/s^2, integral gain to which `delta_ki` is added."""
    delta_kp_min: float = 0.0
    """1/s."""
    delta_kp_max: float = 75.0
    """1/s."""
    delta_ki_min: float = 0.0
    """1/s^2."""
    delta_ki_max: float = 10.0
    """1/s^2."""
    delta_u_max: float = 0.1
    """A."""
    sample_period: float = 1e-3
    """s."""
    integral: str = ""
    """Form of the force law's integral, one of `INTEGRAL_FORMS`; empty: not reported."""


FEEDBACK_FORCES = ("", "load", "hydraulic")
"""Feedback forces of a law, by their number in DETAILS; empty: not reported."""


@dataclass(frozen=True, kw_only=True)
class BoxDetails:
    """A box's DETAILS: identity, laws, limits, time-outs and lags; 0 or empty: not reported."""

    epoch: int = 0
    """Number of the power-on, [1, 2^32 - 1]: a change means that the box was restarted."""
    bench_digest: str = ""
    """Digest of the bench file used by its force law, 12 hexadecimal digits."""
    feedback: str = ""
    """Feedback force of its law, one of `FEEDBACK_FORCES`."""
    laws: int = 0
    """Force laws that it offers, bit n for the `Law` n; 0: the paper's only."""
    load_force_limit: float = 0.0
    """N, magnitude of the load force beyond which it trips while armed."""
    force_range: float = 0.0
    """N, magnitude beyond which a load cell counts as broken and a reference is refused."""
    pressure_min: float = 0.0
    """Pa, below it a pressure sensor counts as broken."""
    pressure_max: float = 0.0
    """Pa, above it a pressure sensor counts as broken."""
    position_min: float = 0.0
    """m, below it the encoder counts as broken."""
    position_max: float = 0.0
    """m, above it the encoder counts as broken."""
    hold_timeout: float = 0.0
    """s without a command until WATCHDOG."""
    trip_timeout: float = 0.0
    """s without a command until TRIPPED."""
    force_rate_age: float = 0.0
    """s, lag of its differentiated forces at low frequency."""
    velocity_age: float = 0.0
    """s, lag of its differentiated position at low frequency."""


@dataclass(frozen=True, kw_only=True)
class BoxLaw:
    """Parameters of a box's compensated law: base gains, limits, rate limits and safe state.

    The safe state, in force without commands, is base gains, C_1 and C_2 as given here, and
    `NEUTRAL_COEFFICIENTS`.
    """

    base_kp: float = 400.0
    """1/s, proportional gain to which `delta_kp` is added."""
    base_ki: float = 15.0
    """1/s^2, integral gain to which `delta_ki` is added."""
    delta_kp_min: float = -385.0
    """1/s."""
    delta_kp_max: float = 0.0
    """1/s."""
    delta_ki_min: float = -10.0
    """1/s^2."""
    delta_ki_max: float = 15.0
    """1/s^2."""
    velocity_compensation: float = 0.0
    """C_1 [-] of the safe state."""
    velocity_compensation_min: float = 0.0
    """Lower limit of C_1 [-]."""
    velocity_compensation_max: float = 0.5
    """Upper limit of C_1 [-]."""
    valve_gain_scale: float = 1.0
    """C_2 [-] of the safe state."""
    valve_gain_scale_min: float = 0.8
    """Lower limit of C_2 [-]."""
    valve_gain_scale_max: float = 3.0
    """Upper limit of C_2 [-]."""
    scale_rate: float = 1.0
    """Rate limit of C_1 and C_2 [1/s]."""
    reference_max: float = 700.0
    """Saturation of the magnitude of f_c [N]."""
    coefficient_min: ReferenceCoefficients = (0.8, -0.02, -0.001, -60.0, -1e-5)
    """Lower limits of a_0 [-], a_1 [s], a_2 [s^2], a_3 [N], a_4 [s^3]."""
    coefficient_max: ReferenceCoefficients = (1.25, 0.15, 0.002, 60.0, 1e-4)
    """Upper limits of a_0 to a_4, in the same units."""
    coefficient_rate: ReferenceCoefficients = (0.5, 0.1, 0.005, 2000.0, 2.5e-4)
    """Rate limits of a_0 to a_4 [1/s], [-], [s], [N/s], [s^2]."""

    @classmethod
    def of_message(cls, message: Any) -> BoxLaw | None:
        """Return the law in a hydro_msgs/BoxLaw, received or recorded; None: the box has none."""
        if not message.offered:
            return None
        numbers: dict[str, Any] = {}
        for name in (entry.name for entry in fields(cls)):
            value = getattr(message, name)
            numbers[name] = tuple(map(float, value)) if name.startswith("coefficient") else float(value)
        return cls(**numbers)

    @property
    def shaping_limits(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """Minimum, safe value, maximum and rate limit of a_0 to a_4, C_1 and C_2."""
        low = [*self.coefficient_min, self.velocity_compensation_min, self.valve_gain_scale_min]
        safe = [*NEUTRAL_COEFFICIENTS, self.velocity_compensation, self.valve_gain_scale]
        high = [*self.coefficient_max, self.velocity_compensation_max, self.valve_gain_scale_max]
        return low, safe, high, [*self.coefficient_rate, self.scale_rate, self.scale_rate]

    def scaled(self, force: float, gain: float) -> BoxLaw:
        """Return the law with its forces scaled by `force` and its gains by `gain`."""

        def level(numbers: ReferenceCoefficients) -> ReferenceCoefficients:
            return (*numbers[:3], force * numbers[3], numbers[4])

        return replace(
            self, reference_max=force * self.reference_max, coefficient_min=level(self.coefficient_min),
            coefficient_max=level(self.coefficient_max), coefficient_rate=level(self.coefficient_rate),
            **{name: gain * getattr(self, name) for name in GAIN_FIELDS},
        )  # fmt: skip


GAIN_FIELDS = ("base_kp", "base_ki", "delta_kp_min", "delta_kp_max", "delta_ki_min", "delta_ki_max")
"""Gains of a law: base values, and the limits of their changes."""

PAPER_LAW = BoxLaw(
    velocity_compensation=1.0, velocity_compensation_min=1.0, velocity_compensation_max=1.0, valve_gain_scale_min=1.0,
    valve_gain_scale_max=1.0, reference_max=1e30, coefficient_min=NEUTRAL_COEFFICIENTS,
    coefficient_max=NEUTRAL_COEFFICIENTS,
)  # fmt: skip
"""Record of the paper's law, which has no shaping. The paper's gains are those of `BoxInfo`."""


class LawState(NamedTuple):
    """State of the force law in one sample; f_c is the measured force while disarmed."""

    law: Law = Law.PAPER
    compensated_reference: float = 0.0
    """f_c [N]."""
    compensated_reference_rate: float = 0.0
    """f_c' [N/s]."""
    coefficients: ReferenceCoefficients = NEUTRAL_COEFFICIENTS
    velocity_compensation: float = 1.0
    """C_1 [-]."""
    valve_gain_scale: float = 1.0
    """C_2 [-]."""


class Hello(NamedTuple):
    """The HELLO frame: identity and protocol versions; `info` is None from the host."""

    sequence: int
    time_us: int
    version_min: int
    version_max: int
    info: BoxInfo | None


class State(NamedTuple):
    """The STATE frame, one sample: `values` in STATE_FIELDS order, flags, and the number of the box's latest command.

    Also the counts of values and of references that the box refused since its power-on, and the state of its law.
    """

    sequence: int
    time_us: int
    values: tuple[float, ...]
    flags: int
    last_command: int
    refused: int
    refused_references: int
    law_state: LawState


class Details(NamedTuple):
    """The DETAILS frame."""

    sequence: int
    time_us: int
    details: BoxDetails


class LawFrame(NamedTuple):
    """The LAW frame: a law that the box offers in addition to the paper's."""

    sequence: int
    time_us: int
    law: Law
    record: BoxLaw


class ClockFrame(NamedTuple):
    """The CLOCK frame of an emulator whose time is not the host's."""

    time_us: int
    waits: bool
    """Whether each sample waits for the COMMAND that carries its time."""


class CommandFrame(NamedTuple):
    """The COMMAND frame: a command as received by the box."""

    sequence: int
    time_us: int
    command: Command


Frame = Hello | State | Details | LawFrame | ClockFrame | CommandFrame

HANDSHAKE_VERSION = 0
"""Version byte of HELLO frames: their layout is the same in all versions, so that any two ends can negotiate."""
ENCODED_SIZE_MAX = 160
"""Maximum number of bytes between two delimiters; more is noise."""

_HEADER = Struct("<BBIQ")
_LAYOUTS = {
    FrameType.HELLO: Struct("<BBIQBBBB32s9f"),
    FrameType.STATE: Struct(f"<BBIQ{len(STATE_FIELDS)}fIIIII9f"),
    FrameType.COMMAND: Struct("<BBIQIIfffIffffI7f"),
    FrameType.DETAILS: Struct("<BBIQI12sBBxx10f"),
    FrameType.LAW: Struct("<BBIQI29f"),
    FrameType.CLOCK: Struct("<BBIQI"),
}
_CRC = Struct("<I")
_ARM_BIT, _FILTER_FRESH_BIT = 1, 2


def encode_command(sequence: int, time_us: int, command: Command) -> bytes:
    """Encode COMMAND; `time_us` is the host's clock."""
    reference = command.reference
    bits = _ARM_BIT * command.arm | _FILTER_FRESH_BIT * command.filter_fresh
    numbers = (command.delta_kp, command.delta_ki, command.delta_u)
    signal = (reference.waveform, reference.amplitude, reference.offset, reference.frequency, reference.phase)
    values = (bits, command.corrected_sequence, *numbers, *signal, command.law, *command.shaping)
    return encode(FrameType.COMMAND, sequence, time_us, *values)


def encode_hello(sequence: int, time_us: int, info: BoxInfo | None = None, *, lock_step: bool = False) -> bytes:
    """Encode HELLO, which opens a connection; `info`: the box's, None from the host.

    `lock_step`: whether the host answers each STATE of an emulator that waits for answers; ignored by a box.
    """
    name, *numbers, integral = astuple(info) if info else ("", *(0.0,) * 9, "")
    who = (VERSION, VERSION, info is not None, INTEGRAL_FORMS.index(integral) if info else lock_step)
    return encode(FrameType.HELLO, sequence, time_us, *who, name.encode()[:32], *numbers)


def encode_clock(time_us: int, *, waits: bool) -> bytes:
    """Encode CLOCK, the time of an emulator; `waits`: each sample waits for the COMMAND with its time."""
    return encode(FrameType.CLOCK, 0, time_us, waits)


def decode(encoded: bytes) -> Frame:
    """Decode the frame between two delimiters.

    Raises MalformedError: broken COBS, length or content; `CheckSumError`, `UnknownFrameError` and `WrongVersionError`
    are subclasses. Nothing else is ever raised.
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
    if version != (HANDSHAKE_VERSION if kind == FrameType.HELLO else VERSION):
        raise WrongVersionError(version)
    if kind not in _READERS:
        raise UnknownFrameError(f"frame type {kind}")
    kind = FrameType(kind)
    if len(body) != (size := _LAYOUTS[kind].size):
        raise MalformedError(f"{len(body)} bytes in a {kind.name} frame, expected {size}")
    return _READERS[kind](*_LAYOUTS[kind].unpack(body)[2:])


def version_mismatch_message(version: int) -> str:
    """Return the error message for a box of another protocol version."""
    newer = version > VERSION
    age, remedy = ("a newer", "update hydro") if newer else ("an older", "rebuild its firmware from firmware/")
    return f"the box speaks {age} protocol than version {VERSION}, and no command is sent: {remedy}"


def encode_frame(body: bytes) -> bytes:
    """Encode a body as a frame: CRC-32, COBS, delimiters."""
    stuffed: bytes = cobs.encode(body + _CRC.pack(crc32(body)))
    return b"\0" + stuffed + b"\0"


def encode(kind: FrameType, sequence: int, time_us: int, *values: Any) -> bytes:
    """Return a frame; numbers beyond the range of float32 become infinite."""
    head = (HANDSHAKE_VERSION if kind is FrameType.HELLO else VERSION, kind, sequence & 0xFFFFFFFF, time_us)
    try:
        return encode_frame(_LAYOUTS[kind].pack(*head, *values))
    except OverflowError:
        beyond = (isinstance(value, float) and abs(value) > 3.4028234e38 for value in values)
        numbers = (copysign(inf, value) if big else value for value, big in zip(values, beyond, strict=True))
        return encode_frame(_LAYOUTS[kind].pack(*head, *numbers))


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")


def _known_law(number: int) -> Law:
    if number > max(Law):
        raise MalformedError(f"law {number}")
    return Law(number)


def _read_hello(sequence: int, time_us: int, *rest: Any) -> Hello:
    version_min, version_max, is_box, form, name, *values = rest
    integral = INTEGRAL_FORMS[form] if form < len(INTEGRAL_FORMS) else ""
    numbers = dict(zip([entry.name for entry in fields(BoxInfo)][1:-1], values, strict=True))
    info = BoxInfo(name=_text(name), integral=integral, **numbers) if is_box else None
    return Hello(sequence, time_us, version_min, version_max, info)


def _read_state(sequence: int, time_us: int, *rest: Any) -> State:
    *values, flags, last_command, refused, references, law, value, rate, a_0, a_1, a_2, a_3, a_4, c_1, c_2 = rest
    acting = LawState(_known_law(law), value, rate, (a_0, a_1, a_2, a_3, a_4), c_1, c_2)
    return State(sequence, time_us, tuple(values), flags, last_command, refused, references, acting)


def _read_details(
    sequence: int, time_us: int, epoch: int, digest: bytes, feedback: int, laws: int, *rest: float
) -> Details:
    force = FEEDBACK_FORCES[feedback] if feedback < len(FEEDBACK_FORCES) else ""
    numbers = dict(zip([entry.name for entry in fields(BoxDetails)][4:], rest, strict=True))
    details = BoxDetails(epoch=epoch, bench_digest=_text(digest), feedback=force, laws=laws, **numbers)
    return Details(sequence, time_us, details)


def _read_law(sequence: int, time_us: int, law: int, *rest: float) -> LawFrame:
    values = (*rest[:14], rest[14:19], rest[19:24], rest[24:])
    record: dict[str, Any] = dict(zip([entry.name for entry in fields(BoxLaw)], values, strict=True))
    return LawFrame(sequence, time_us, _known_law(law), BoxLaw(**record))


def _read_command(sequence: int, time_us: int, *rest: Any) -> CommandFrame:
    bits, corrects, delta_kp, delta_ki, delta_u, waveform, amplitude, offset, frequency, phase = rest[:10]
    law, a_0, a_1, a_2, a_3, a_4, c_1, c_2 = rest[10:]
    if waveform > Waveform.SMOOTH_STEP:
        raise MalformedError(f"waveform {waveform}")
    command = Command(
        arm=bool(bits & _ARM_BIT),
        delta_kp=delta_kp,
        delta_ki=delta_ki,
        delta_u=delta_u,
        reference=ReferenceSignal(
            waveform=Waveform(waveform), amplitude=amplitude, offset=offset, frequency=frequency, phase=phase
        ),
        corrected_sequence=corrects,
        filter_fresh=bool(bits & _FILTER_FRESH_BIT),
        law=_known_law(law),
        coefficients=(a_0, a_1, a_2, a_3, a_4),
        velocity_compensation=c_1,
        valve_gain_scale=c_2,
    )
    return CommandFrame(sequence, time_us, command)


_READERS: dict[int, Callable[..., Frame]] = {
    FrameType.HELLO: _read_hello,
    FrameType.STATE: _read_state,
    FrameType.COMMAND: _read_command,
    FrameType.DETAILS: _read_details,
    FrameType.LAW: _read_law,
    FrameType.CLOCK: lambda _, time_us, waits: ClockFrame(time_us, bool(waits)),
}
