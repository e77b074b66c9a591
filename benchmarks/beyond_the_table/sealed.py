# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # m v' = ... + size v^2: flyweights on a pinion of the rod throw it outwards, whichever way they turn
    entry("flyweights", "sealed", "motion", (150.0, 600.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # ... - size min(v, 0): a scraper whose edge lies over on the way out and digs in on the way in
    entry("scraper_digs", "sealed", "motion", (50.0, 200.0), "N s/m", 0.0, "velocity", degree=1.0),
    # ... - size sin(pi x / shape)^2 v: a bore with the waves that a chattering hone has left
    entry("honed_waves", "sealed", "motion", (80.0, 320.0), "N s/m", 8e-3, "position velocity"),
    # ... - size max(p_b - w, 0) tanh(v / 5 mm/s), w' = (p_b - w) / shape: a lip that a rise of pressure presses on the
    # rod until its plastic has flowed
    entry("lip_relaxes", "sealed", "motion", (5e-6, 2e-5), "N/Pa", 0.2, "pressure_b velocity", memory=True),
    # out of B to the tank: q = size max(p_a - shape, 0) sqrt(p_b - p_t): a check valve that A's pressure lifts early
    entry("pilot_check", "sealed", "pressure_b", (1e-16, 4e-16), "m3/s/Pa^1.5", 6e6, "pressure_a pressure_b",
          degree=1.5),
    # out of A: q = size w', w' = (p_a - w) / (20 ms rising, shape falling): a pocket behind a lip that lets oil in only
    entry("lip_pocket", "sealed", "pressure_a", (1e-14, 4e-14), "m3/Pa", 0.3, "pressure_a", memory=True),
    # out of B to the tank: q = size max(shape - x, 0) (p_b - p_t): a rod that is scuffed towards its outer end
    entry("rod_scuffed", "sealed", "pressure_b", (2.5e-12, 1e-11), "m2/s/Pa", 0.042, "position pressure_b", degree=2.0),
    # spool = u - size (x - rest): a wire from the rod to the feedback spring, as of a valve for positioning
    entry("feedback_link", "sealed", FLOW, (1.8e-3, 7.2e-3), "A/m", 0.0, "position", degree=1.0),
    # spool = u - size (u - w), w' = (u - w) / shape: a share of the iron's flux comes late, for its eddies
    entry("flux_creeps", "sealed", FLOW, (9e-3, 3.6e-2), "-", 0.05, "current", memory=True),
    # the edge to the supply sees p_s - size in the second half of each period shape: a neighbour on the pump strokes
    entry("neighbour_strokes", "sealed", FLOW, (4e5, 1.6e6), "Pa", 1.6, "current pressure_a pressure_b time"),
    # load += size (x - rest) / sqrt((x - rest)^2 + shape^2): a wire across, which a weight keeps taut
    entry("cross_wire", "sealed", "load", (15.0, 60.0), "N", 6e-3, "position"),
    # load += size max(v - w, 0), w' = max(v - w, 0) / shape - w / 0.6 s: a flywheel behind a freewheel with slip
    entry("freewheel", "sealed", "load", (100.0, 400.0), "N s/m", 0.06, "velocity", memory=True),
    # load += size sin(2 pi t / shape): a motor with an unbalance runs on the specimen's table
    entry("unbalanced_motor", "sealed", "load", (1.5, 6.0), "N", 0.15, "time"),
    # load cell reads f, and f (1 + size) where |f| > shape: its amplifier changes range, and the ranges do not agree
    entry("cell_ranges", "sealed", "sensor", (0.02, 0.08), "-", 100.0, "load_force", degree=1.0),
    # encoder reads x + size sin(2 pi x / shape): its two tracks are not of one amplitude
    entry("scale_ripple", "sealed", "sensor", (1.2e-5, 4.8e-5), "m", 4e-3, "position"),
    # hydraulic cell reads F as it was at the last multiple of size: a slow converter that holds what it gave last
    entry("cell_holds", "sealed", "sensor", (1e-2, 4e-2), "s", 0.0, "hydraulic_force", memory=True),
)  # fmt: skip
