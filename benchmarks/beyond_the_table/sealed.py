# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # force on the piston: -size sqrt(|v|) sign(v): a seal on its film of oil
    entry("seal_film_drag", "sealed", "motion", (10.0, 40.0), "N/(m/s)^0.5", 0.0, "velocity", degree=0.5),
    # friction on the piston: size |pA - pB| tanh(v / 5 mm/s): the piston's lips are pressed on by the difference
    entry("piston_lip_friction", "sealed", "motion", (1e-6, 4e-6), "N/Pa", 0.0, "velocity pressure_a pressure_b",
          degree=1.0),
    # friction on the piston: size |F_load| tanh(v / 5 mm/s): the load stands askew and loads the rod's guide sideways
    entry("askew_load_friction", "sealed", "motion", (0.02, 0.08), "1", 0.0, "velocity load_force", degree=1.0),
    # force on the piston: -size (x - shape): hoses and cables that bend with the rod, past the load cell
    entry("cable_loop_spring", "sealed", "motion", (500.0, 2000.0), "N/m", 0.038, "position"),
    # out of B to the tank: size sqrt(pB - p_tank): a scratch across the rod's seal
    entry("rod_seal_scratch", "sealed", "pressure_b", (4e-11, 1.6e-10), "m3/s/Pa^0.5", 0.0, "pressure_b", degree=0.5),
    # out of A: dW/dt = (size pA - W) / shape: the wall of a rubber hose creeps after the pressure
    entry("hose_wall_creep", "sealed", "pressure_a", (4e-15, 1.6e-14), "m3/Pa", 0.03, "pressure_a", memory=True),
    # from A to B: size exp(-((x - 0.04 m) / shape)^2) (pA - pB): a bore worn where the piston works
    entry("bore_worn_mid", "sealed", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 4e-3, "position pressure_a pressure_b"),
    # out of A to the tank: size max(pA - shape, 0): a relief valve set too low
    entry("relief_weeps_a", "sealed", "pressure_a", (1.2e-12, 4.8e-12), "m3/s/Pa", 6.5e6, "pressure_a", degree=1.0),
    # spool: i / (1 + size |i|): the flow curve bends over as the ports and passages throttle
    entry("flow_curve_bends", "sealed", FLOW, (1.0, 4.0), "1/A", 0.0, "current"),
    # spool: play of width size after the current: hysteresis of the torque motor
    entry("torque_motor_play", "sealed", FLOW, (3e-5, 1.2e-4), "A", 0.0, "current", memory=True),
    # spool: i + size (1 - exp(-t / shape)): the null shifts while the valve warms up
    entry("null_warms_up", "sealed", FLOW, (4e-5, 1.6e-4), "A", 8.0, "time"),
    # load: + size max(x - shape, 0): the first coils of the spring touch, and it stiffens at once
    entry("coils_touch", "sealed", "load", (1500.0, 6000.0), "N/m", 0.044, "position", degree=1.0),
    # load: + size a: the plate between load cell and spring has a mass
    entry("spring_plate_mass", "sealed", "load", (0.4, 1.6), "kg", 0.0, "acceleration", degree=1.0),
    # load: + size |x - x_rest| tanh(v / shape): the spring bulges and rubs along its guide [k mu = size]
    entry("spring_rubs_guide", "sealed", "load", (200.0, 800.0), "N/m", 0.01, "position velocity"),
    # load cell reads F + size F^2: its bridge is bowed
    entry("load_cell_bow", "sealed", "sensor", (6e-5, 2.4e-4), "1/N", 0.0, "load_force", degree=2.0),
    # gauge B reads (1 + size) pB: its span is wrong
    entry("gauge_span_b", "sealed", "sensor", (8e-3, 3.2e-2), "1", 0.0, "pressure_b", degree=1.0),
)  # fmt: skip
