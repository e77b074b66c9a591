# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # m v' = ... - size p_b tanh(v / shape): a rod seal that B's pressure presses on
    entry("rod_seal_pressure_friction", "sealed", "motion", (8e-7, 3.2e-6), "N/Pa", 3e-3, "velocity pressure_b",
          degree=1.0),
    # ... - size |f_l| tanh(v / shape): a misaligned spring loads the rod's bush sideways
    entry("side_load_friction", "sealed", "motion", (0.05, 0.2), "-", 3e-3, "velocity load_force", degree=1.0),
    # ... - size exp(-((x - shape) / 2 mm)^2) tanh(v / 3 mm/s): a tight spot in the bore, from a dent or a bent rod
    entry("tight_spot_friction", "sealed", "motion", (8.0, 32.0), "N", 0.04, "position velocity"),
    # ... - size v |v|: oil that is squeezed through ports and past the piston
    entry("turbulent_drag", "sealed", "motion", (500.0, 2000.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # out of B to the tank: q = size max(p_b - shape, 0): a relief or anti-shock valve set too low
    entry("relief_cracking_b", "sealed", "pressure_b", (1e-13, 4e-13), "m3/s/Pa", 7.5e6, "pressure_b", degree=1.0),
    # A to B: q = size (p_a - p_b) where x > shape: a bore that is scored from there on
    entry("scored_bore_leakage", "sealed", CHAMBERS, (3e-14, 1.2e-13), "m3/s/Pa", 0.039,
          "position pressure_a pressure_b", degree=1.0),
    # out of A: q = size (p_a - w) / shape, w' = (p_a - w) / shape: a hose's wall that creeps
    entry("hose_creep_a", "sealed", "pressure_a", (1e-14, 4e-14), "m3/Pa", 0.05, "pressure_a", memory=True, degree=1.0),
    # out of B: q = size p_b where v > 0: a rod seal that weeps as the rod comes out
    entry("rod_seal_weep_extending", "sealed", "pressure_b", (2.5e-14, 1e-13), "m3/s/Pa", 0.0, "velocity pressure_b",
          degree=1.0),
    # spool = w, w = min(max(w, u - size), u + size): a spool that follows the current with play
    entry("valve_hysteresis_play", "sealed", FLOW, (1.6e-5, 6.4e-5), "A", 0.0, "current", memory=True),
    # spool = u - size (p_a - p_b): unequal ends of the spool
    entry("null_shift_load_pressure", "sealed", FLOW, (3.5e-12, 1.4e-11), "A/Pa", 0.0, "pressure_a pressure_b",
          degree=1.0),
    # the edges to the supply see p_s + size sin(2 pi shape t): a pump whose compensator hunts
    entry("supply_hunting", "sealed", FLOW, (3e5, 1.2e6), "Pa", 2.5, "current pressure_a pressure_b time"),
    # load += size tanh(v / shape): dry friction of the spring's guide and of its end coils
    entry("spring_guide_friction", "sealed", "load", (5.0, 20.0), "N", 3e-3, "velocity", degree=0.0),
    # load += size x'': carriage, plate and a part of the spring beyond the cell
    entry("carriage_inertia_at_cell", "sealed", "load", (0.8, 3.2), "kg", 0.0, "acceleration", degree=1.0),
    # load += size max(x - shape, 0): coils that begin to close, or a second spring
    entry("coil_contact", "sealed", "load", (3000.0, 12000.0), "N/m", 0.042, "position", degree=1.0),
    # encoder reads x + size f_l: a bracket that flexes under the load
    entry("encoder_mount_flex", "sealed", "sensor", (1e-7, 4e-7), "m/N", 0.0, "load_force", degree=1.0),
    # load cell reads f + size (1 - exp(-t / shape)): an amplifier whose zero drifts as it warms
    entry("load_cell_warm_up", "sealed", "sensor", (9.0, 36.0), "N", 15.0, "time"),
)  # fmt: skip
