# SPDX-License-Identifier: Apache-2.0
"""Checks that every bench of this kind satisfies, each with the wiring mistakes that violate it.

A force goes with the pressures that make it, a spring's with its travel, the piston runs where the valve sends it,
numbers are of the size of the bench's, and no sensor copies another. The margins are several times what any effect of
the table does to a recording (column_maps.md, "Mistakes of wiring and units").
"""

from __future__ import annotations

from hydro_diagnosis.wiring.complaint import Check
from hydro_diagnosis.wiring.copies import copies
from hydro_diagnosis.wiring.forces import force_and_pressures, force_and_spring, forces
from hydro_diagnosis.wiring.sizes import current_sizes, position_sizes, pressure_sizes
from hydro_diagnosis.wiring.valve import current_and_motion, current_and_pressures

CHECKS: tuple[Check, ...] = (
    copies,
    pressure_sizes,
    position_sizes,
    current_sizes,
    force_and_pressures,
    force_and_spring,
    forces,
    current_and_motion,
    current_and_pressures,
)
"""All checks, in the order of reporting."""
