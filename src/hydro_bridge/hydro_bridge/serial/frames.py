# SPDX-License-Identifier: Apache-2.0
"""Frames of the serial line, and their errors."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any, NamedTuple

from hydro_bridge.signals import NEUTRAL, Coefficients, Command, Law

VERSION_MIN = 1
"""Lowest supported protocol version."""
VERSION = 3
"""Highest supported protocol version."""


class FrameType(IntEnum):
    """Second byte of a frame."""

    HELLO = 1
    STATE = 2
    COMMAND = 3
    DETAILS = 4
    """From version 2 on."""
    LAW = 5
    """From version 3 on."""


class MalformedError(ValueError):
    """A frame with a valid check sum whose content does not follow the byte tables."""


class CheckSumError(MalformedError):
    """The CRC-32 does not match."""


class UnknownFrameError(MalformedError):
    """An unknown frame type of this protocol version: skipped, so that newer boxes may add types."""


class WrongVersionError(MalformedError):
    """A frame of another version, given by `version`."""

    def __init__(self, version: int) -> None:
        super().__init__(f"frame of version {version}, here {VERSION_MIN} to {VERSION} are spoken")
        self.version = version


INTEGRAL_FORMS = ("", "paper", "bumpless")
"""Forms of the force law's integral by their number in HELLO: not reported, K_i int e dt, int K_i e dt."""


@dataclass(frozen=True, kw_only=True)
class BoxInfo:
    """A box's HELLO: identity and limits; the bridge never exceeds these."""

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


FEEDBACKS = ("", "load", "hydraulic")
"""Forces that a law can follow, by their number in DETAILS; empty: not reported."""


@dataclass(frozen=True, kw_only=True)
class BoxDetails:
    """A box's DETAILS, from protocol version 2 on; 0 or empty: not reported."""

    epoch: int = 0
    """Number of its power-on, [1, 2^32 - 1]: a change means that the box was restarted."""
    bench_digest: str = ""
    """Digest of the bench file used by its force law, 12 hexadecimal digits."""
    feedback: str = ""
    """Force that its law follows, one of `FEEDBACKS`."""
    laws: int = 0
    """Force laws that it offers, bit n for the `Law` n; 0, and before version 3: the paper's alone."""
    load_force_limit: float = 0.0
    """N, magnitude of the load force beyond which it trips while armed."""
    force_range: float = 0.0
    """N, magnitude beyond which a load cell counts as broken, and beyond which no reference may reach."""
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
    """A box's compensated law, from protocol version 3 on: one record, absolute limits, its own safe state.

    Without commands the law's base gains, base C_1 and C_2, and `NEUTRAL` coefficients hold.
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
    """C_1 is never below."""
    velocity_compensation_max: float = 0.5
    """C_1 is never above."""
    valve_gain_scale: float = 1.0
    """C_2 [-] of the safe state."""
    valve_gain_scale_min: float = 0.8
    """C_2 is never below."""
    valve_gain_scale_max: float = 3.0
    """C_2 is never above."""
    scale_rate: float = 1.0
    """1/s, fastest change of C_1 and C_2."""
    reference_max: float = 700.0
    """N, magnitude at which f_c is cut off."""
    coefficient_min: Coefficients = (0.8, -0.02, -0.001, -60.0)
    """Lower limits of a_0 [-], a_1 [s], a_2 [s^2], a_3 [N]."""
    coefficient_max: Coefficients = (1.25, 0.15, 0.002, 60.0)
    """Upper limits."""
    coefficient_rate: Coefficients = (0.5, 0.1, 0.005, 2000.0)
    """Fastest changes [1/s], [-], [s], [N/s]."""

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
    def shaping(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """Lowest, safe and highest a_0 to a_3, C_1, C_2, and their fastest changes."""
        low = [*self.coefficient_min, self.velocity_compensation_min, self.valve_gain_scale_min]
        safe = [*NEUTRAL, self.velocity_compensation, self.valve_gain_scale]
        high = [*self.coefficient_max, self.velocity_compensation_max, self.valve_gain_scale_max]
        return low, safe, high, [*self.coefficient_rate, self.scale_rate, self.scale_rate]

    def enlarged(self, force: float, gain: float) -> BoxLaw:
        """Return the law of a box whose bench has forces, and needs gains, larger by these ratios."""

        def level(numbers: Coefficients) -> Coefficients:
            return (*numbers[:3], force * numbers[3])

        return replace(
            self, reference_max=force * self.reference_max, coefficient_min=level(self.coefficient_min),
            coefficient_max=level(self.coefficient_max), coefficient_rate=level(self.coefficient_rate),
            **{name: gain * getattr(self, name) for name in _GAINS},
        )  # fmt: skip


_GAINS = ("base_kp", "base_ki", "delta_kp_min", "delta_kp_max", "delta_ki_min", "delta_ki_max")

PAPER_LAW = BoxLaw(
    velocity_compensation=1.0, velocity_compensation_min=1.0, velocity_compensation_max=1.0, valve_gain_scale_min=1.0,
    valve_gain_scale_max=1.0, reference_max=1e30, coefficient_min=NEUTRAL, coefficient_max=NEUTRAL,
)  # fmt: skip
"""What the paper's law makes of the same record: nothing to shape. Its gains are those of `BoxInfo`."""


class LawState(NamedTuple):
    """Force law of a box as it acts in one sample, from version 3 on; f_c is the force itself while disarmed."""

    law: Law
    compensated_reference: float
    """f_c [N]."""
    compensated_reference_rate: float
    """f_c' [N/s]."""
    coefficients: Coefficients
    velocity_compensation: float
    """C_1."""
    valve_gain_scale: float
    """C_2."""


class Hello(NamedTuple):
    """HELLO: identity and protocol versions; `info` is None from the host."""

    sequence: int
    time_us: int
    version_min: int
    version_max: int
    info: BoxInfo | None


class State(NamedTuple):
    """One sample: `values` in STATE_FIELDS order, flags, and the sequence number of the box's latest command.

    From version 2 on also the numbers of values and of references that the box refused since its power-on, from
    version 3 on its force law.
    """

    sequence: int
    time_us: int
    values: tuple[float, ...]
    flags: int
    last_command: int
    refused: int | None = None
    refused_references: int | None = None
    law_state: LawState | None = None


class Details(NamedTuple):
    """The DETAILS frame."""

    sequence: int
    time_us: int
    details: BoxDetails


class LawFrame(NamedTuple):
    """The LAW frame: a law that the box offers beside the paper's."""

    sequence: int
    time_us: int
    law: Law
    record: BoxLaw


class CommandFrame(NamedTuple):
    """A command as the box receives it."""

    sequence: int
    time_us: int
    command: Command


Frame = Hello | State | Details | LawFrame | CommandFrame
