# SPDX-License-Identifier: Apache-2.0
"""Signals exchanged between box and graph: names, order and meaning, without ROS.

One sample of the bench as a numpy record (`STATE_DTYPE`)::

    time | sequence | hydraulic_force ... piston_velocity | valve_current ... integral_gain | flags
     s      uint32    |------ PLANT_FIELDS, the state x ---|                                | uint32
                      |------------------ STATE_FIELDS, 14 float64 ------------------------|
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
StateArray = npt.NDArray[np.void]
"""Array of `STATE_DTYPE` records, one per millisecond."""

SAMPLE_PERIOD = 1e-3
"""Sample period of the box, s."""

SAMPLES_PER_STEP = 10
"""Samples per policy step: the policy sets gains at 100 Hz (paper, section Real-World Training Implementation)."""

STATE_FIELDS: tuple[str, ...] = (
    "hydraulic_force",  # N
    "hydraulic_force_rate",  # N/s
    "load_force",  # N
    "load_force_rate",  # N/s
    "pressure_a",  # Pa
    "pressure_b",  # Pa
    "piston_position",  # m
    "piston_velocity",  # m/s
    "valve_current",  # A
    "nominal_valve_current",  # A
    "reference_force",  # N
    "reference_force_rate",  # N/s
    "proportional_gain",  # 1/s
    "integral_gain",  # 1/s^2
)
"""The float fields of hydro_msgs/BenchState, in message order."""

PLANT_FIELDS: tuple[str, ...] = STATE_FIELDS[:8]
"""The state x of the paper (eq. state_def)."""

STATE_DTYPE = np.dtype(
    [("time", np.float64), ("sequence", np.uint32), *((name, np.float64) for name in STATE_FIELDS),
     ("flags", np.uint32)],
    align=True,
)  # fmt: skip
"""Record type of one sample, 136 bytes; padded so that every float is aligned, for numba and SIMD."""


class Flag(IntEnum):
    """Bits of `BenchState.flags`; a combination of flags is a plain int."""

    ARMED = 1
    SATURATED = 2
    WATCHDOG = 4
    TRIPPED = 8
    SENSOR_FAULT = 16
    FORCE_LIMIT = 32
    FILTER_STALE = 64
    EXTRAPOLATING = 128
    PACED = 256


FAULT_FLAGS = Flag.FORCE_LIMIT | Flag.SENSOR_FAULT
"""Trip flags that a controller may have caused; a trip without them is the box's time-out for commands."""


def flag_names(flags: int) -> str:
    """Return the names of the set flags as text, `no flags` if there are none."""
    return ", ".join(str(flag.name) for flag in Flag if flag & flags) or "no flags"


class Waveform(IntEnum):
    """Waveforms of a reference: HOLD is `offset`, the others add `amplitude` times a shape within [-1, 1]."""

    HOLD = 0
    SINE = 1
    MULTISINE = 2
    SMOOTH_STEP = 3


FADE_TIME = 0.3
"""Duration of the cross-fade from one reference to the next, s."""


class CorrectionStatus(IntEnum):
    """Decisions of the contraction filter on a sample, in `Correction.status`."""

    PASS = 0
    MODIFIED = 1
    RELAXED = 2
    INFEASIBLE = 3
    NAN = 4
    STALE = 5
    BYPASSED = 6
    MISMATCH = 7


class Law(IntEnum):
    """Force laws of a box (`firmware/hydro/force_law.h`): the paper's, and the one with a compensated reference."""

    PAPER = 0
    COMPENSATED = 1


ReferenceCoefficients = tuple[float, float, float, float, float]
"""a_0 [-], a_1 [s], a_2 [s^2], a_3 [N], a_4 [s^3] of f_c = a_0 f_r + a_1 f_r' + a_2 f_r'' + a_3 + a_4 f_r'''."""

NEUTRAL_COEFFICIENTS: ReferenceCoefficients = (1.0, 0.0, 0.0, 0.0, 0.0)
"""Neutral coefficients of the compensated reference: f_c = f_r."""


@dataclass(frozen=True, kw_only=True)
class LawCommand:
    """Command of a force law: the law, the coefficients of its reference, and its scales C_1 and C_2.

    The defaults are the paper's law; a box's compensated law has safe values of its own (`safety.guard.safe_command`).
    """

    law: Law = Law.PAPER
    """Force law to run, taken up at arming; while armed, a command for another law causes the safe state."""
    coefficients: ReferenceCoefficients = NEUTRAL_COEFFICIENTS
    """Coefficients of the compensated reference; the box ramps to them."""
    velocity_compensation: float = 1.0
    """C_1 [-], share of the velocity term h of the force dynamics that the law compensates."""
    valve_gain_scale: float = 1.0
    """C_2 [-], factor on the valve gain g in the law."""

    @property
    def shaping(self) -> tuple[float, ...]:
        """Coefficients a_0 to a_4, and scales C_1 and C_2."""
        return *self.coefficients, self.velocity_compensation, self.valve_gain_scale


@dataclass(frozen=True, kw_only=True)
class ReferenceSignal:
    """Reference force that the box generates and tracks."""

    waveform: Waveform = Waveform.HOLD
    amplitude: float = 0.0
    """N, 0 or more."""
    offset: float = 0.0
    """N."""
    frequency: float = 1.0
    """Hz, above 0."""
    phase: float = 0.0
    """rad."""


@dataclass(frozen=True, kw_only=True)
class Command(LawCommand):
    """The command sent to the box each millisecond; the defaults are the safe command."""

    arm: bool = False
    """Whether the valve may follow the force law."""
    delta_kp: float = 0.0
    """1/s, added to the base proportional gain."""
    delta_ki: float = 0.0
    """1/s^2, added to the base integral gain."""
    delta_u: float = 0.0
    """A, added to the nominal valve current before saturation."""
    reference: ReferenceSignal = ReferenceSignal()
    """Reference force to track."""
    corrected_sequence: int = 0
    """Sequence number of the sample from which `delta_u` was computed."""
    filter_fresh: bool = False
    """Whether this command is backed by a fresh correction of the filter; if not, the box flags FILTER_STALE."""


def to_matrix(states: StateArray, fields: tuple[str, ...] = PLANT_FIELDS) -> FloatArray:
    """Return k float fields of n records of `STATE_DTYPE` as a copy of shape (n, k), C-contiguous."""
    return np.stack([states[name] for name in fields], axis=-1)
