# SPDX-License-Identifier: Apache-2.0
"""Numbers of a bench: those of bench.yaml, and those of everything that a bench may have beyond them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import yaml

BENCH_FILE = Path(__file__).resolve().parents[2] / "src/hydro_sim/hydro_sim/data/bench.yaml"


class Numbers(NamedTuple):
    """A bench, SI units: of the truth, or (the first block alone) what the box believes. Compiled code reads it."""

    bulk_modulus: float
    piston_area: float
    area_ratio: float
    stroke: float
    supply_pressure: float
    tank_pressure: float
    valve_nominal_flow: float
    valve_nominal_current: float
    valve_nominal_pressure_drop: float
    valve_current_max: float
    dead_volume_a: float
    dead_volume_b: float
    moving_mass: float
    viscous_friction: float
    spring_stiffness: float
    spring_rest_position: float
    load_cell_bandwidth: float

    valve_delay: float = 0.0
    """s, of the current."""
    spool_bandwidth: float = 0.0
    """Hz, second order; 0: the spool follows at once."""
    spool_damping: float = 0.8
    valve_offset: float = 0.0
    """A."""
    valve_overlap: float = 0.0
    """A, half width of the dead band."""
    valve_gain: float = 1.0
    """Ratio of the flow to the nominal one."""
    valve_gain_drift: float = 0.0
    """1/s."""
    valve_asymmetry: float = 1.0
    """Ratio of the flow at negative openings to that at positive ones."""
    droop_resistance: float = 0.0
    """Pa s/m3, of the supply line."""
    droop_time: float = 0.05
    """s."""

    air: float = 0.0
    """Share of the volume at atmospheric pressure."""
    leak_internal: float = 0.0
    """m3/s/Pa, between the chambers."""
    leak_a: float = 0.0
    """m3/s/Pa, to the tank."""
    leak_b: float = 0.0

    coulomb: float = 0.0
    """N."""
    stribeck: float = 0.0
    """N above `coulomb` at standstill."""
    stribeck_velocity: float = 0.01
    """m/s."""
    spring_cubic: float = 0.0
    """N/m3."""
    backlash: float = 0.0
    """m, at the spring."""
    cushion_stiffness: float = 0.0
    """N/m beyond `cushion_position`, on the piston."""
    cushion_position: float = 0.0
    """m."""
    force_offset: float = 0.0
    """N."""

    load_cell_gain: float = 1.0
    load_cell_bias: float = 0.0
    """N."""
    gauge_a_bias: float = 0.0
    """Pa."""
    gauge_b_bias: float = 0.0
    """Pa."""


@cache
def _file() -> dict[str, float]:
    content = yaml.safe_load(BENCH_FILE.read_text(encoding="utf-8"))
    return {key: float(content[key]) for key in Numbers._fields if key in content}


def numbers(**changes: float) -> Numbers:
    """The bench of bench.yaml with changes; raises TypeError for a field that there is not."""
    return Numbers(**{**_file(), **changes})
