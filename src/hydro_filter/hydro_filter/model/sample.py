# SPDX-License-Identifier: Apache-2.0
"""Inputs of the filter: one bench sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, Flag, FloatArray


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
    """What the valve got [A]: nominal, plus the last correction, within the valve's limit."""
    reference_rate: float = 0.0
    """f_r' [N/s]."""
    armed: bool = True
    """Whether the valve follows the law at all."""

    @classmethod
    def of(cls, record: np.void) -> Sample:
        """From a record of `hydro_bridge.signals.STATE_DTYPE`."""
        state = np.array([record[name] for name in PLANT_FIELDS], dtype=np.float64)
        gain, force = float(record["proportional_gain"]), float(record["reference_force"])
        current, rate = float(record["valve_current"]), float(record["reference_force_rate"])
        armed = bool(int(record["flags"]) & Flag.ARMED)
        return cls(state, float(record["nominal_valve_current"]), force, gain, current, rate, armed)
