# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # ... - size w tanh(v / 2 mm/s), w' = (1 - w) / shape - |v| w / 8 mm: at rest lips squeeze their film out
    entry("film_squeezed", "sealed", "motion", (10.0, 40.0), "N", 0.15, "velocity", memory=True),
    # ... - size p_b (x - rest): a hose that the rod's end carries along stiffens with its pressure
    entry("hose_stiffens", "sealed", "motion", (1e-4, 4e-4), "N/Pa/m", 0.0, "position pressure_b", degree=2.0),
    # ... - size max(p_b - shape, 0) tanh(v / 5 mm/s): a backup ring, pressed on the rod beyond a pressure
    entry("backup_ring", "sealed", "motion", (5e-6, 2e-5), "N/Pa", 9.5e6, "pressure_b velocity", degree=1.0),
    # ... - size d exp(-d^2), d = (x - 36 mm) / shape: the magnet of a switch draws the rod to it
    entry("switch_magnet", "sealed", "motion", (12.0, 45.0), "N", 3e-3, "position"),
    # A to B: q = size |x - rest| (p_a - p_b): the load's bent spring tilts the piston and opens its gap
    entry("piston_tilts", "sealed", CHAMBERS, (8e-12, 3e-11), "m2/s/Pa", 0.0, "position pressure_a pressure_b",
            degree=2.0),
    # out of B to the tank: q = size w, w' = (max(p_b - shape, 0) - w) / 40 ms: a relief valve whose poppet is late
    entry("slow_relief", "sealed", "pressure_b", (4e-13, 1.6e-12), "m3/s/Pa", 1e7, "pressure_b", memory=True),
    # out of B to the tank: q = size p_b^2: a gland whose gap widens with the pressure in it
    entry("gap_widens", "sealed", "pressure_b", (5e-21, 2e-20), "m3/s/Pa2", 0.0, "pressure_b", degree=2.0),
    # spool = u - size x'': the valve rides on what moves, and its spool lags behind
    entry("valve_rides", "sealed", FLOW, (1e-5, 4e-5), "A s2/m", 0.0, "acceleration", degree=1.0),
    # over the edge to the tank dp - size max(dp - shape, 0) acts for dp: its jet cavitates
    entry("edge_chokes", "sealed", FLOW, (0.1, 0.4), "-", 4e6, "current pressure_a pressure_b"),
    # spool = u (1 - size w), w' = ((u / 5 mA)^2 - w) / shape: a warm coil draws less from an amplifier of voltage
    entry("coil_warms", "sealed", FLOW, (0.1, 0.35), "-", 2.0, "current", memory=True),
    # load += size max(x - rest, 0)^2: a conical spring, whose coils lie down one after another
    entry("conical_spring", "sealed", "load", (6e4, 2.4e5), "N/m2", 0.0, "position", degree=2.0),
    # load -= size k (x - rest) exp(-t / shape): a specimen that beds in
    entry("specimen_beds_in", "sealed", "load", (0.07, 0.25), "-", 6.0, "time position", degree=1.0),
    # load += size |x - rest| w, w' = (v - |v| w) / shape: wire rope, whose strands rub the more the more it is bent
    entry("wire_rope", "sealed", "load", (600.0, 2400.0), "N/m", 2e-3, "position velocity", memory=True),
    # hydraulic cell reads F (1 - size |u| / u_n): its bridge and the valve hang on one weak supply
    entry("bridge_sags", "sealed", "sensor", (0.4, 1.6), "-", 0.0, "hydraulic_force current", degree=2.0),
    # load cell reads f + size w, w' = (f' - |f'| w) / shape: its steel gives back less than it took
    entry("cell_hysteresis", "sealed", "sensor", (5.0, 20.0), "N", 60.0, "load_force", memory=True),
    # gauge B reads p_b + size p_a: their amplifiers share a bad ground
    entry("gauge_crosstalk", "sealed", "sensor", (0.015, 0.06), "-", 0.0, "pressure_a", degree=1.0),
)  # fmt: skip
