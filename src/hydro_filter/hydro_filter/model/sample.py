# SPDX-License-Identifier: Apache-2.0
"""Inputs of the filter: one bench sample, and the layout of its state x."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import PLANT_FIELDS, Flag, FloatArray, Law

STATE_SIZE = 8
"""Length of x (paper eq. state_def)."""

(
    HYDRAULIC_FORCE, HYDRAULIC_FORCE_RATE, LOAD_FORCE, LOAD_FORCE_RATE, PRESSURE_A, PRESSURE_B, POSITION, VELOCITY,
) = range(STATE_SIZE)  # fmt: skip
"""Indices into x."""


class Sample(NamedTuple):
    """State and force-law output of one sample, SI units."""

    state: FloatArray
    """x (paper eq. state_def), shape (8,)."""
    nominal_current: float
    """u_nom [A], before correction and saturation."""
    reference_force: float
    """f_r [N]."""
    proportional_gain: float
    """K_p + delta K_p [1/s]."""
    valve_current: float = 0.0
    """Applied valve current [A]: nominal plus the last correction, saturated."""
    reference_rate: float = 0.0
    """f_r' [N/s]."""
    armed: bool = True
    """Whether the valve follows the law."""
    law: LawState | None = None
    """State of the force law; None: the paper's law."""

    @property
    def compensated(self) -> bool:
        """Whether the compensated force law is active."""
        return self.law is not None and self.law.law is Law.COMPENSATED

    @property
    def law_inputs(self) -> tuple[float, float, float, float]:
        """f_c [N], f_c' [N/s], C_1 and C_2 of the force law; f_r, f_r', 1 and 1 for the paper's."""
        if self.law is None:
            return self.reference_force, self.reference_rate, 1.0, 1.0
        return (
            self.law.compensated_reference, self.law.compensated_reference_rate,
            self.law.velocity_compensation, self.law.valve_gain_scale,
        )  # fmt: skip

    @classmethod
    def from_record(cls, record: np.void, law: LawState | None = None) -> Sample:
        """Create a sample from a record of `STATE_DTYPE` and the state of the force law; None: the paper's."""
        state = np.array([record[name] for name in PLANT_FIELDS], dtype=np.float64)
        gain, force = float(record["proportional_gain"]), float(record["reference_force"])
        current, rate = float(record["valve_current"]), float(record["reference_force_rate"])
        armed = bool(int(record["flags"]) & Flag.ARMED)
        return cls(state, float(record["nominal_valve_current"]), force, gain, current, rate, armed, law)
