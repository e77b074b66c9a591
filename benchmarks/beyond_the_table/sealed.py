# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # ... - size max(|v| - shape, 0) sign(v): a lip that a fast rod starves of oil
    entry("starved_film", "sealed", "motion", (150.0, 600.0), "N s/m", 0.06, "velocity", degree=1.0),
    # ... - size max(rest - x, 0)^2 tanh(v / 5 mm/s): a pressed spring bows and leans the rod on its guide
    entry("spring_bows", "sealed", "motion", (6e4, 2.4e5), "N/m2", 0.0, "position velocity", degree=2.0),
    # ... - size w tanh(v / 2 mm/s), w' = (|v| / 0.1 m/s - w) / shape: a plastic guide swells as it rubs itself warm
    entry("guide_swells", "sealed", "motion", (10.0, 40.0), "N", 3.0, "velocity", memory=True),
    # A to B: q = size (1 - exp(-t / shape)) (p_a - p_b): a leak that grows as the tank's oil warms
    entry("tank_warms", "sealed", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 10.0, "time pressure_a pressure_b"),
    # out of B: q = size sqrt(p_b - w), signed, w' = q / shape: a pulsation damper behind an orifice
    entry("damper_stub", "sealed", "pressure_b", (1e-10, 4e-10), "m3/s/sqrt(Pa)", 3e-14, "pressure_b", memory=True),
    # out of B to the tank: q = size p_b max(shape - p_b, 0): lips that seal only under pressure
    entry("lips_close", "sealed", "pressure_b", (1.5e-20, 6e-20), "m3/s/Pa2", 1e7, "pressure_b", degree=2.0),
    # A to B: q = size |v| (p_a - p_b): the film lifts the piston's lips off the bore
    entry("lips_lift", "sealed", CHAMBERS, (5e-13, 2e-12), "m2/Pa", 0.0, "pressure_a pressure_b velocity", degree=2.0),
    # spool = u - size min(|u|, shape) sign(u): notches meter about null, the whole edge beyond
    entry("notched_spool", "sealed", FLOW, (0.04, 0.16), "-", 2e-3, "current", degree=1.0),
    # the edge to the supply sees p_s - size (1 - exp(-t / shape)): the pump's relief valve sets down as it warms
    entry("supply_sets", "sealed", FLOW, (5e5, 2e6), "Pa", 6.0, "current pressure_a pressure_b time"),
    # spool = w, w' = (u - w) / (size rising, 0.2 ms falling): one of the pilot's two nozzles is half clogged
    entry("pilot_clogged", "sealed", FLOW, (8e-4, 3.2e-3), "s", 0.0, "current", memory=True),
    # load += size ((1 - (x - rest) / shape)^-1.4 - 1): an air spring beside the coil
    entry("air_spring", "sealed", "load", (25.0, 100.0), "N", 0.05, "position"),
    # load += size max(x - rest, 0) v: foam that is pressed, and its air leaves by ever closer pores
    entry("foam_block", "sealed", "load", (4e3, 1.6e4), "N s/m2", 0.0, "position velocity", degree=2.0),
    # spring's foot y' = size max(|k (x - rest - y)| - shape, 0), signed: a specimen that slips in its jaws
    entry("jaws_slip", "sealed", "load", (2e-5, 8e-5), "m/s/N", 120.0, "position", memory=True),
    # hydraulic cell reads F + size u^2: its amplifier rectifies the ripple of the valve's
    entry("cell_rectifies", "sealed", "sensor", (4e5, 1.6e6), "N/A2", 0.0, "current", degree=2.0),
    # load cell reads f - size min(|f|, shape) sign(f): its thread seats only under load
    entry("cell_seats", "sealed", "sensor", (0.06, 0.24), "-", 60.0, "load_force", degree=1.0),
    # hydraulic cell reads w, w' = (F - w) / 0.5 ms, but no faster than size: an input with a filter against spikes
    entry("cell_slew", "sealed", "sensor", (1500.0, 3000.0), "N/s", 0.0, "hydraulic_force", memory=True),
)  # fmt: skip
