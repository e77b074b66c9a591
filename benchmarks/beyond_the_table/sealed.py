# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # m v' = ... + size max(u, 0)^2 (p_s - p_a): the jet out of A's port strikes the piston's face
    entry("port_jet", "sealed", "motion", (0.0175, 0.07), "N/A2/Pa", 0.0, "current pressure_a"),
    # ... - size p_b w, w' = (v - |v| w) / shape: an O-ring, pressed by the oil, rolls in its groove before it slides
    entry("ring_rolls", "sealed", "motion", (1e-6, 4e-6), "N/Pa", 5e-4, "pressure_b velocity", memory=True),
    # ... - size sin(2 pi x / shape): a weight off the axis of a pinion that the rod turns
    entry("eccentric_pinion", "sealed", "motion", (5.0, 20.0), "N", 0.025, "position"),
    # ... - size v / (1 - x / shape)^3: the film between two plates that come close, as it is squeezed and filled
    entry("squeeze_film", "sealed", "motion", (5.0, 20.0), "N s/m", 0.085, "position velocity"),
    # A to B: q = size w (p_a - p_b), w' = |v| (1 - w) / shape - w / 0.5 s: a gap that dirt silts up at rest, and that
    # the moving piston wipes clear
    entry("gap_silts", "sealed", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 0.03, "pressure_a pressure_b velocity",
          memory=True),
    # A gets w for the valve's flow q_v, w' = (q_v - w) / size: the oil in a long thin pipe has to be set moving
    entry("pipe_inertia", "sealed", "pressure_a", (2.5e-4, 1e-3), "s", 0.0, "current pressure_a", memory=True),
    # out of B: q = size d/dt max(p_b - shape, 0): an accumulator that takes oil beyond its precharge alone
    entry("precharged", "sealed", "pressure_b", (2e-14, 8e-14), "m3/Pa", 1e7, "pressure_b", degree=1.0),
    # spool = u + size sin(2 pi t / shape): an amplifier whose dither was left on
    entry("dither_left", "sealed", FLOW, (5e-5, 2e-4), "A", 0.031, "time"),
    # spool = u + size w, w' = (u - w) / 50 ms where |u| > shape, else 0: iron that strong currents alone magnetise
    entry("remanence", "sealed", FLOW, (0.003, 0.012), "-", 4e-3, "current", memory=True),
    # A's edges see u + size, B's u - size: lands that are ground apart by a little, one port's null beside the other's
    entry("lands_apart", "sealed", FLOW, (5e-5, 2e-4), "A", 0.0, "current pressure_a pressure_b"),
    # load -= size (w - |x - rest|) (x - rest), w' = max(|x - rest| - w, 0) / 5 ms - w / shape: filled rubber is the
    # softer the further it has been stretched before
    entry("rubber_remembers", "sealed", "load", (1e5, 4e5), "N/m2", 5.0, "position", memory=True),
    # load += size exp(-((x - 38 mm) / shape)^2) v: a copper plate that passes a magnet's gap
    entry("magnet_gap", "sealed", "load", (60.0, 240.0), "N s/m", 4e-3, "position velocity"),
    # load += size max(v^2 - shape^2, 0) sign(v): shoes that leave their springs at a speed and rub on a drum
    entry("centrifugal_brake", "sealed", "load", (500.0, 2000.0), "N s2/m2", 0.05, "velocity", degree=2.0),
    # load cell reads f + size v: its cable swings through a field
    entry("cable_swings", "sealed", "sensor", (40.0, 160.0), "N s/m", 0.0, "velocity", degree=1.0),
    # gauge A reads p_a - size max(v, 0)^2: its hole lies in the throat of the jet that drives the piston out
    entry("throat_tapped", "sealed", "sensor", (8e6, 3.2e7), "Pa s2/m2", 0.0, "velocity", degree=2.0),
    # encoder reads x - w, w' = size max(|v| - shape, 0) sign(v): a counter that misses counts when they come fast
    entry("counts_lost", "sealed", "sensor", (0.01, 0.04), "-", 0.06, "velocity", memory=True),
)  # fmt: skip
