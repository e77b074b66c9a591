# SPDX-License-Identifier: Apache-2.0
"""The sealed kinds: no improvement has looked at them."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

SEALED: tuple[Kind, ...] = (
    # m v' = ... - size p_a v: a hollow lip that the oil of A blows up, and its film shears the harder
    entry("blown_lip", "sealed", "motion", (1e-5, 4e-5), "N s/m/Pa", 0.0, "pressure_a velocity", degree=2.0),
    # ... - size v / (1 + (v / shape)^2): the encoder's magnet drags eddies along an aluminium wall, less when fast
    entry("eddy_ring", "sealed", "motion", (150.0, 600.0), "N s/m", 0.05, "velocity"),
    # ... - size (1 + tanh((x - shape) / 1 mm)) / 2 tanh(v / 5 mm/s): of two rails end to end the second runs dry
    entry("dry_rail", "sealed", "motion", (8.0, 32.0), "N", 0.042, "position velocity"),
    # ... - size (v - w), w' = (v - w) / shape: a pot on the rod's end, whose oil its walls drag along
    entry("oil_pot", "sealed", "motion", (25.0, 75.0), "N s/m", 0.03, "velocity", memory=True),
    # A to B: q = size max(x - shape, 0) sqrt(p_a - p_b), signed: a groove in the barrel that the piston uncovers
    entry("bypass_groove", "sealed", CHAMBERS, (1e-8, 4e-8), "m2/s/sqrt(Pa)", 0.042, "position pressure_a pressure_b",
          degree=1.5),
    # into A: q = size sqrt(p_s - p_a): a land that is scored from the supply's groove to A's, wherever the spool is
    entry("worn_land", "sealed", "pressure_a", (3e-11, 1.2e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_a"),
    # into B: q = size exp(-t / shape): cold oil that the warm block expands
    entry("oil_expands", "sealed", "pressure_b", (1.5e-7, 6e-7), "m3/s", 8.0, "time"),
    # spool = u / sqrt(1 + size (u / shape)^2): the iron of the torque motor saturates
    entry("motor_saturates", "sealed", FLOW, (0.15, 0.6), "-", 0.01, "current"),
    # the edge to the tank sees p_t + w, w' = (size q - w) / shape: a throttled return line with air before its throttle
    entry("return_pot", "sealed", FLOW, (1e10, 4e10), "Pa s/m3", 0.1, "current pressure_a pressure_b", memory=True),
    # A gets (1 - size max(shape - x, 0)) of the valve's flow: near its end the piston covers A's port
    entry("port_covered", "sealed", "pressure_a", (7.0, 28.0), "1/m", 0.037, "position current pressure_a"),
    # load += size tanh(v / shape): a specimen with a dry joint
    entry("friction_strut", "sealed", "load", (6.0, 24.0), "N", 3e-3, "velocity", degree=0.0),
    # load += size (x - rest) |v|: rubber that is the stiffer the faster it is worked
    entry("rubber_quickens", "sealed", "load", (6e3, 2.4e4), "N s/m2", 0.0, "position velocity", degree=2.0),
    # load += size max(x - rest - w, 0), w' = (x - rest - w) / shape: slow foam, from which the plate lifts off
    entry("memory_foam", "sealed", "load", (600.0, 2400.0), "N/m", 0.4, "position", memory=True),
    # gauge B reads a multiple of size, the nearest: a digital gauge of few bits
    entry("gauge_coarse", "sealed", "sensor", (3.5e5, 9e5), "Pa", 0.0, "pressure_b"),
    # hydraulic cell reads F (1 + size (1 - exp(-t / shape))): its bridge warms under its own supply
    entry("cell_gain_warms", "sealed", "sensor", (0.03, 0.12), "-", 6.0, "time hydraulic_force", degree=1.0),
    # encoder reads x - size p_b: its head stands on the barrel, which stretches under the gland
    entry("barrel_stretches", "sealed", "sensor", (2.5e-12, 1e-11), "m/Pa", 0.0, "pressure_b", degree=1.0),
)  # fmt: skip
