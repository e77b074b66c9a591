# SPDX-License-Identifier: Apache-2.0
"""Layout of the state."""

from __future__ import annotations

STATES = 8
"""Length of x (paper eq. state_def)."""

(
    HYDRAULIC_FORCE,
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    PRESSURE_A,
    PRESSURE_B,
    POSITION,
    VELOCITY,
) = range(STATES)
"""Indices into x."""
