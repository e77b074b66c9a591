# SPDX-License-Identifier: Apache-2.0
"""The kinds of physics outside the table: where each lives, how large it is drawn, its right form.

`dev` is the ninth half, which improvements have looked at since; `sealed` is the tenth, which none has.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """One kind of physics that no effect id names."""

    name: str
    half: str
    """`dev`, which improvements may look at, or `sealed`."""
    equations: str
    """Where a report may locate it: ids of `location`, in words apart."""
    size: tuple[float, float]
    """Range of its magnitude; drawn with either end equally likely, by logarithm."""
    unit: str
    shape: float
    """Its second number (a time, a position, a width), SI."""
    variables: str
    """What a law of the right form depends on, and nothing else, in words apart."""
    memory: bool = False
    """Whether a law of the right form has a state of its own."""
    degree: float | None = None
    """Total power of the signals in the law, where the form is a monomial; signs and thresholds count nothing."""


FLOW = "actuation pressure_a pressure_b"
CHAMBERS = "pressure_a pressure_b"

KINDS: tuple[Kind, ...] = (
    # m v' = ... - size p_b tanh(v / shape): a rod seal that B's pressure presses on
    Kind("rod_seal_pressure_friction", "dev", "motion", (8e-7, 3.2e-6), "N/Pa", 3e-3, "velocity pressure_b",
         degree=1.0),
    # ... - size |f_l| tanh(v / shape): a misaligned spring loads the rod's bush sideways
    Kind("side_load_friction", "dev", "motion", (0.05, 0.2), "-", 3e-3, "velocity load_force", degree=1.0),
    # ... - size exp(-((x - shape) / 2 mm)^2) tanh(v / 3 mm/s): a tight spot in the bore, from a dent or a bent rod
    Kind("tight_spot_friction", "dev", "motion", (8.0, 32.0), "N", 0.04, "position velocity"),
    # ... - size v |v|: oil that is squeezed through ports and past the piston
    Kind("turbulent_drag", "dev", "motion", (500.0, 2000.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # out of B to the tank: q = size max(p_b - shape, 0): a relief or anti-shock valve set too low
    Kind("relief_cracking_b", "dev", "pressure_b", (1e-13, 4e-13), "m3/s/Pa", 7.5e6, "pressure_b", degree=1.0),
    # A to B: q = size (p_a - p_b) where x > shape: a bore that is scored from there on
    Kind("scored_bore_leakage", "dev", CHAMBERS, (3e-14, 1.2e-13), "m3/s/Pa", 0.039,
         "position pressure_a pressure_b", degree=1.0),
    # out of A: q = size (p_a - w) / shape, w' = (p_a - w) / shape: a hose's wall that creeps
    Kind("hose_creep_a", "dev", "pressure_a", (1e-14, 4e-14), "m3/Pa", 0.05, "pressure_a", memory=True, degree=1.0),
    # out of B: q = size p_b where v > 0: a rod seal that weeps as the rod comes out
    Kind("rod_seal_weep_extending", "dev", "pressure_b", (2.5e-14, 1e-13), "m3/s/Pa", 0.0, "velocity pressure_b",
         degree=1.0),
    # spool = w, w = min(max(w, u - size), u + size): a spool that follows the current with play
    Kind("valve_hysteresis_play", "dev", FLOW, (1.6e-5, 6.4e-5), "A", 0.0, "current", memory=True),
    # spool = u - size (p_a - p_b): unequal ends of the spool
    Kind("null_shift_load_pressure", "dev", FLOW, (3.5e-12, 1.4e-11), "A/Pa", 0.0, "pressure_a pressure_b",
         degree=1.0),
    # the edges to the supply see p_s + size sin(2 pi shape t): a pump whose compensator hunts
    Kind("supply_hunting", "dev", FLOW, (3e5, 1.2e6), "Pa", 2.5, "current pressure_a pressure_b time"),
    # load += size tanh(v / shape): dry friction of the spring's guide and of its end coils
    Kind("spring_guide_friction", "dev", "load", (5.0, 20.0), "N", 3e-3, "velocity", degree=0.0),
    # load += size x'': carriage, plate and a part of the spring beyond the cell
    Kind("carriage_inertia_at_cell", "dev", "load", (0.8, 3.2), "kg", 0.0, "acceleration", degree=1.0),
    # load += size max(x - shape, 0): coils that begin to close, or a second spring
    Kind("coil_contact", "dev", "load", (3000.0, 12000.0), "N/m", 0.042, "position", degree=1.0),
    # encoder reads x + size f_l: a bracket that flexes under the load
    Kind("encoder_mount_flex", "dev", "sensor", (1e-7, 4e-7), "m/N", 0.0, "load_force", degree=1.0),
    # load cell reads f + size (1 - exp(-t / shape)): an amplifier whose zero drifts as it warms
    Kind("load_cell_warm_up", "dev", "sensor", (9.0, 36.0), "N", 15.0, "time"),
    # force on the piston: -size sqrt(|v|) sign(v): a seal on its film of oil
    Kind("seal_film_drag", "sealed", "motion", (10.0, 40.0), "N/(m/s)^0.5", 0.0, "velocity", degree=0.5),
    # friction on the piston: size |pA - pB| tanh(v / 5 mm/s): the piston's lips are pressed on by the difference
    Kind("piston_lip_friction", "sealed", "motion", (1e-6, 4e-6), "N/Pa", 0.0, "velocity pressure_a pressure_b",
         degree=1.0),
    # friction on the piston: size |F_load| tanh(v / 5 mm/s): the load stands askew and loads the rod's guide sideways
    Kind("askew_load_friction", "sealed", "motion", (0.02, 0.08), "1", 0.0, "velocity load_force", degree=1.0),
    # force on the piston: -size (x - shape): hoses and cables that bend with the rod, past the load cell
    Kind("cable_loop_spring", "sealed", "motion", (500.0, 2000.0), "N/m", 0.038, "position"),
    # out of B to the tank: size sqrt(pB - p_tank): a scratch across the rod's seal
    Kind("rod_seal_scratch", "sealed", "pressure_b", (4e-11, 1.6e-10), "m3/s/Pa^0.5", 0.0, "pressure_b", degree=0.5),
    # out of A: dW/dt = (size pA - W) / shape: the wall of a rubber hose creeps after the pressure
    Kind("hose_wall_creep", "sealed", "pressure_a", (4e-15, 1.6e-14), "m3/Pa", 0.03, "pressure_a", memory=True),
    # from A to B: size exp(-((x - 0.04 m) / shape)^2) (pA - pB): a bore worn where the piston works
    Kind("bore_worn_mid", "sealed", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 4e-3, "position pressure_a pressure_b"),
    # out of A to the tank: size max(pA - shape, 0): a relief valve set too low
    Kind("relief_weeps_a", "sealed", "pressure_a", (1.2e-12, 4.8e-12), "m3/s/Pa", 6.5e6, "pressure_a", degree=1.0),
    # spool: i / (1 + size |i|): the flow curve bends over as the ports and passages throttle
    Kind("flow_curve_bends", "sealed", FLOW, (1.0, 4.0), "1/A", 0.0, "current"),
    # spool: play of width size after the current: hysteresis of the torque motor
    Kind("torque_motor_play", "sealed", FLOW, (3e-5, 1.2e-4), "A", 0.0, "current", memory=True),
    # spool: i + size (1 - exp(-t / shape)): the null shifts while the valve warms up
    Kind("null_warms_up", "sealed", FLOW, (4e-5, 1.6e-4), "A", 8.0, "time"),
    # load: + size max(x - shape, 0): the first coils of the spring touch, and it stiffens at once
    Kind("coils_touch", "sealed", "load", (1500.0, 6000.0), "N/m", 0.044, "position", degree=1.0),
    # load: + size a: the plate between load cell and spring has a mass
    Kind("spring_plate_mass", "sealed", "load", (0.4, 1.6), "kg", 0.0, "acceleration", degree=1.0),
    # load: + size |x - x_rest| tanh(v / shape): the spring bulges and rubs along its guide [k mu = size]
    Kind("spring_rubs_guide", "sealed", "load", (200.0, 800.0), "N/m", 0.01, "position velocity"),
    # load cell reads F + size F^2: its bridge is bowed
    Kind("load_cell_bow", "sealed", "sensor", (6e-5, 2.4e-4), "1/N", 0.0, "load_force", degree=2.0),
    # gauge B reads (1 + size) pB: its span is wrong
    Kind("gauge_span_b", "sealed", "sensor", (8e-3, 3.2e-2), "1", 0.0, "pressure_b", degree=1.0),
)  # fmt: skip
NAMES = tuple(kind.name for kind in KINDS)
"""Compiled code knows a kind by its place here; -1 is none."""
HALVES = ("dev", "sealed", "named")
"""`named`: what the table names."""
