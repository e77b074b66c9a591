# SPDX-License-Identifier: Apache-2.0
"""The kinds that have been looked at: nine halves, sealed once, in the order in which they were opened."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import CHAMBERS, FLOW, Kind, entry

OPENED: tuple[Kind, ...] = (
    # m v' = ... - size v |v|
    entry("drag_square", "dev", "motion", (400.0, 1500.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # ... - size ((x - rest) / shape)^2 v: a bore that narrows away from its middle
    entry("friction_position", "dev", "motion", (60.0, 200.0), "N s/m", 0.01, "position velocity", degree=3.0),
    # spool = u - size w, w' = (u' - |u'| w) / shape: magnetic hysteresis of a torque motor
    entry("valve_hysteresis", "dev", FLOW, (1.5e-4, 5e-4), "A", 3e-4, "current", memory=True),
    # spool = u (1 - size |u| / u_n): ports that narrow as they open (widening ones make the loop swing)
    entry("valve_curve", "dev", FLOW, (0.2, 0.5), "-", 0.05, "current", degree=2.0),
    # q = size sqrt(p_a - p_b), signed: a worn edge between the chambers
    entry("leak_orifice", "dev", CHAMBERS, (1.5e-10, 5e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_a pressure_b",
          degree=0.5, named="leakage_internal orifice"),
    # hose of chamber A: q = size (p_a - w) / shape, w' = (p_a - w) / shape
    entry("hose_memory", "dev", "pressure_a", (1.5e-14, 5e-14), "m3/Pa", 0.15, "pressure_a", memory=True),
    # load += size w, w' = v / shape - |v| w / shape: the spring loads on one path and unloads on another
    entry("spring_hysteresis", "dev", "load", (4.0, 15.0), "N", 2e-3, "position velocity", memory=True),
    # hydraulic cell reads F + size w, w' = (F - w) / shape
    entry("cell_creep", "dev", "sensor", (0.06, 0.15), "-", 1.5, "hydraulic_force", memory=True),
    # ... - size |p_a - p_b| tanh(v / shape): a lip that the pressure presses on the rod
    entry("seal_drop", "dev", "motion", (1.5e-6, 4e-6), "N/Pa", 2e-3, "pressure_a pressure_b velocity", degree=1.0),
    # ... - size max(x - shape, 0) v: a throttle that closes towards the end
    entry("cushion_damping", "dev", "motion", (2e4, 8e4), "N s/m2", 0.043, "position velocity", degree=2.0),
    # ... - size exp(-w) v, w' = |v| / shape - w / 10 s: oil thins as it warms
    entry("oil_heat", "dev", "motion", (80.0, 250.0), "N s/m", 0.25, "velocity", memory=True),
    # spool' = u - spool at 300 Hz, but no faster than size
    entry("spool_rate", "dev", FLOW, (0.2, 0.4), "A/s", 300.0, "current", memory=True),
    # sqrt(dp) becomes dp / sqrt(|dp| + size): laminar below, turbulent above
    entry("flow_transition", "dev", FLOW, (4e5, 2e6), "Pa", 0.0, "current pressure_a pressure_b"),
    # q = size (p_a - p_b) while the piston moves out: a lip that opens one way
    entry("leak_by_motion", "dev", CHAMBERS, (6e-14, 2e-13), "m3/s/Pa", 2e-3, "pressure_a pressure_b velocity",
          degree=1.0),
    # foot y of the spring: y' = (size load / k - y) / shape
    entry("flexible_mount", "dev", "load", (0.02, 0.08), "-", 0.08, "position", memory=True),
    # hydraulic cell reads F + size F^2
    entry("cell_curve", "dev", "sensor", (3e-5, 1.2e-4), "1/N", 0.0, "hydraulic_force", degree=2.0),
    # ... - size exp(-(w / 50 mm/s)^2) tanh(v / 2 mm/s), w' = (v - w) / shape: the film follows late
    entry("friction_lag", "dev", "motion", (8.0, 30.0), "N", 0.02, "velocity", memory=True),
    # ... - size exp(-((x - 43 mm) / shape)^2) tanh(v / 2 mm/s): a scored length of the bore
    entry("bore_score", "dev", "motion", (8.0, 30.0), "N", 3e-3, "position velocity"),
    # ... - size v / (1 + |v| / shape): oil whose long molecules align in a fast film
    entry("shear_thinning", "dev", "motion", (100.0, 400.0), "N s/m", 0.03, "velocity"),
    # out of A to the tank: q = size max(p_a - shape, 0): a port relief valve set too low
    entry("port_relief", "dev", "pressure_a", (2e-13, 8e-13), "m3/s/Pa", 6.3e6, "pressure_a", degree=1.0),
    # A to B: q = size (p_a - p_b) exp(-((x - 45 mm) / shape)^2): a barrel worn where it works most
    entry("worn_bore", "dev", CHAMBERS, (1e-13, 4e-13), "m3/s/Pa", 4e-3, "position pressure_a pressure_b"),
    # A to B: q = size w (p_a - p_b), w' = (|u| / u_n - w) / shape: throttled oil warms and the leak with it
    entry("hot_leak", "dev", CHAMBERS, (2e-12, 6e-12), "m3/s/Pa", 3.0, "current pressure_a pressure_b",
          memory=True),
    # out of B: q = size A_b max(v, 0): a grooved rod carries oil out, the scraper takes it off on the way in
    entry("rod_film", "dev", "pressure_b", (0.01, 0.04), "-", 0.0, "velocity", degree=1.0),
    # spool = u - size max(u - shape, 0): a spring stop that the spool meets early on one side
    entry("spool_stop", "dev", FLOW, (0.2, 0.6), "-", 2.5e-3, "current", degree=1.0),
    # spool = u + size w, w' = (|u| / u_n - w) / shape: null moves as throttled oil warms the valve
    entry("null_warms", "dev", FLOW, (1e-3, 3e-3), "A", 4.0, "current", memory=True),
    # the edge to the tank sees p_t + size q^2: a clogged return filter
    entry("return_filter", "dev", FLOW, (5e14, 3e15), "Pa s2/m6", 0.0, "current pressure_a pressure_b"),
    # load += size max(x - shape, 0): a second spring, reached on the way
    entry("stop_spring", "dev", "load", (1e3, 6e3), "N/m", 0.045, "position", degree=1.0),
    # load += size max(v, 0)^2: a shock absorber with a check valve
    entry("rebound_damper", "dev", "load", (400.0, 1500.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # load += size k |x - rest| tanh(v / shape): leaves that rub the more the more they are bent
    entry("leaf_spring", "dev", "load", (0.02, 0.08), "-", 5e-3, "position velocity", degree=1.0),
    # hydraulic cell reads F + size u: its cable lies beside the valve's
    entry("cell_pickup", "dev", "sensor", (1000.0, 6000.0), "N/A", 0.0, "current", degree=1.0),
    # gauge B reads p_b + size (1 - exp(-t / shape)): its zero drifts until it is warm
    entry("gauge_warms", "dev", "sensor", (8e4, 4e5), "Pa", 8.0, "time"),
    # gauge B reads w, w' = (p_b - w) / (0.5 ms rising, size falling): a snubber with a check valve
    entry("gauge_snubber", "dev", "sensor", (5e-3, 2e-2), "s", 0.0, "pressure_b", memory=True),
    # ... - size p_b tanh(v / shape): the gland's lips, pressed on the rod by the oil that they hold
    entry("gland_pressure", "dev", "motion", (1e-6, 3.5e-6), "N/Pa", 2e-3, "pressure_b velocity", degree=1.0),
    # ... - size v / sqrt(|v| + shape): the film under a lip carries more the faster it is drawn, by the root
    entry("lip_film", "dev", "motion", (30.0, 120.0), "N/sqrt(m/s)", 1e-3, "velocity", degree=0.5),
    # ... - size (x - rest - w), w' = (x - rest - w) / shape: a bellows over the rod that breathes by a small hole
    entry("rod_bellows", "dev", "motion", (600.0, 3000.0), "N/m", 0.2, "position", memory=True),
    # ... - size exp(-t / shape) v: a bench that starts cold
    entry("cold_start", "dev", "motion", (150.0, 600.0), "N s/m", 8.0, "time velocity"),
    # out of B to the tank: q = size sqrt(p_b - p_t): a fitting that weeps
    entry("weeping_fitting", "dev", "pressure_b", (1.5e-10, 6e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_b", degree=0.5),
    # B to A: q = size max(p_b - p_a - shape, 0): a lip that is lifted from its back
    entry("blow_by", "dev", CHAMBERS, (2e-13, 1e-12), "m3/s/Pa", 3.8e6, "pressure_a pressure_b", degree=1.0),
    # A to B: q = size (1 - w^2) (p_a - p_b), w' = (v - |v| w) / shape: a ring that leaves its seat at each reversal
    entry("floating_ring", "dev", CHAMBERS, (1.2e-13, 5e-13), "m3/s/Pa", 5e-4, "pressure_a pressure_b velocity",
          memory=True),
    # into B while the valve drives out: q = size K_v max(u, 0) sqrt(p_b - p_t): one edge of four is silted up
    entry("silted_edge", "dev", "pressure_b", (0.03, 0.12), "-", 0.0, "current pressure_b", degree=1.5),
    # spool = u / (1 + size dp), dp over both open edges: the jets close the valve against its spring
    entry("jet_force", "dev", FLOW, (3e-9, 1e-8), "1/Pa", 0.0, "current pressure_a pressure_b"),
    # spool = u - size (p_a - p_b): the load's pressure leans on the spool
    entry("load_null", "dev", FLOW, (1e-11, 4e-11), "A/Pa", 0.0, "pressure_a pressure_b", degree=1.0),
    # load += size v: a specimen that damps
    entry("specimen_damping", "dev", "load", (25.0, 120.0), "N s/m", 0.0, "velocity", degree=1.0),
    # load += size x'': a grip beyond the cell, its mass besides the piston's
    entry("grip_mass", "dev", "load", (0.8, 3.0), "kg", 0.0, "acceleration", degree=1.0),
    # load -= size w k (x - rest), w' = (|v| / 0.1 m/s - w) / shape: rubber softens as it is worked warm
    entry("specimen_softens", "dev", "load", (0.05, 0.15), "-", 4.0, "position velocity", memory=True),
    # load cell reads f + size max(-f, 0): a joint that passes part of a pull by the cell
    entry("cell_bypass", "dev", "sensor", (0.03, 0.1), "-", 0.0, "load_force", degree=1.0),
    # gauge B reads p_b - size max(p_b - shape, 0): its amplifier runs into its limit
    entry("gauge_limit", "dev", "sensor", (0.3, 1.0), "-", 1.15e7, "pressure_b", degree=1.0),
    # encoder reads x - size w, w' = (v - |v| w) / shape: play in its coupling
    entry("encoder_play", "dev", "sensor", (3e-5, 1e-4), "m", 3e-4, "position velocity", memory=True),
    # ... - size w tanh(v / 2 mm/s), w' = (1 - w) / shape - |v| w / 8 mm: at rest lips squeeze their film out
    entry("film_squeezed", "dev", "motion", (10.0, 40.0), "N", 0.15, "velocity", memory=True),
    # ... - size p_b (x - rest): a hose that the rod's end carries along stiffens with its pressure
    entry("hose_stiffens", "dev", "motion", (1e-4, 4e-4), "N/Pa/m", 0.0, "position pressure_b", degree=2.0),
    # ... - size max(p_b - shape, 0) tanh(v / 5 mm/s): a backup ring, pressed on the rod beyond a pressure
    entry("backup_ring", "dev", "motion", (5e-6, 2e-5), "N/Pa", 9.5e6, "pressure_b velocity", degree=1.0),
    # ... - size d exp(-d^2), d = (x - 36 mm) / shape: the magnet of a switch draws the rod to it
    entry("switch_magnet", "dev", "motion", (12.0, 45.0), "N", 3e-3, "position"),
    # A to B: q = size |x - rest| (p_a - p_b): the load's bent spring tilts the piston and opens its gap
    entry("piston_tilts", "dev", CHAMBERS, (8e-12, 3e-11), "m2/s/Pa", 0.0, "position pressure_a pressure_b",
            degree=2.0),
    # out of B to the tank: q = size w, w' = (max(p_b - shape, 0) - w) / 40 ms: a relief valve whose poppet is late
    entry("slow_relief", "dev", "pressure_b", (4e-13, 1.6e-12), "m3/s/Pa", 1e7, "pressure_b", memory=True),
    # out of B to the tank: q = size p_b^2: a gland whose gap widens with the pressure in it
    entry("gap_widens", "dev", "pressure_b", (5e-21, 2e-20), "m3/s/Pa2", 0.0, "pressure_b", degree=2.0),
    # spool = u - size x'': the valve rides on what moves, and its spool lags behind
    entry("valve_rides", "dev", FLOW, (1e-5, 4e-5), "A s2/m", 0.0, "acceleration", degree=1.0),
    # over the edge to the tank dp - size max(dp - shape, 0) acts for dp: its jet cavitates
    entry("edge_chokes", "dev", FLOW, (0.1, 0.4), "-", 4e6, "current pressure_a pressure_b"),
    # spool = u (1 - size w), w' = ((u / 5 mA)^2 - w) / shape: a warm coil draws less from an amplifier of voltage
    entry("coil_warms", "dev", FLOW, (0.1, 0.35), "-", 2.0, "current", memory=True),
    # load += size max(x - rest, 0)^2: a conical spring, whose coils lie down one after another
    entry("conical_spring", "dev", "load", (6e4, 2.4e5), "N/m2", 0.0, "position", degree=2.0),
    # load -= size k (x - rest) exp(-t / shape): a specimen that beds in
    entry("specimen_beds_in", "dev", "load", (0.07, 0.25), "-", 6.0, "time position", degree=1.0),
    # load += size |x - rest| w, w' = (v - |v| w) / shape: wire rope, whose strands rub the more the more it is bent
    entry("wire_rope", "dev", "load", (600.0, 2400.0), "N/m", 2e-3, "position velocity", memory=True),
    # hydraulic cell reads F (1 - size |u| / u_n): its bridge and the valve hang on one weak supply
    entry("bridge_sags", "dev", "sensor", (0.4, 1.6), "-", 0.0, "hydraulic_force current", degree=2.0),
    # load cell reads f + size w, w' = (f' - |f'| w) / shape: its steel gives back less than it took
    entry("cell_hysteresis", "dev", "sensor", (5.0, 20.0), "N", 60.0, "load_force", memory=True),
    # gauge B reads p_b + size p_a: their amplifiers share a bad ground
    entry("gauge_crosstalk", "dev", "sensor", (0.015, 0.06), "-", 0.0, "pressure_a", degree=1.0),
    # ... - size max(|v| - shape, 0) sign(v): a lip that a fast rod starves of oil
    entry("starved_film", "dev", "motion", (150.0, 600.0), "N s/m", 0.06, "velocity", degree=1.0),
    # ... - size max(rest - x, 0)^2 tanh(v / 5 mm/s): a pressed spring bows and leans the rod on its guide
    entry("spring_bows", "dev", "motion", (6e4, 2.4e5), "N/m2", 0.0, "position velocity", degree=2.0),
    # ... - size w tanh(v / 2 mm/s), w' = (|v| / 0.1 m/s - w) / shape: a plastic guide swells as it rubs itself warm
    entry("guide_swells", "dev", "motion", (10.0, 40.0), "N", 3.0, "velocity", memory=True),
    # A to B: q = size (1 - exp(-t / shape)) (p_a - p_b): a leak that grows as the tank's oil warms
    entry("tank_warms", "dev", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 10.0, "time pressure_a pressure_b"),
    # out of B: q = size sqrt(p_b - w), signed, w' = q / shape: a pulsation damper behind an orifice
    entry("damper_stub", "dev", "pressure_b", (1e-10, 4e-10), "m3/s/sqrt(Pa)", 3e-14, "pressure_b", memory=True),
    # out of B to the tank: q = size p_b max(shape - p_b, 0): lips that seal only under pressure
    entry("lips_close", "dev", "pressure_b", (1.5e-20, 6e-20), "m3/s/Pa2", 1e7, "pressure_b", degree=2.0),
    # A to B: q = size |v| (p_a - p_b): the film lifts the piston's lips off the bore
    entry("lips_lift", "dev", CHAMBERS, (5e-13, 2e-12), "m2/Pa", 0.0, "pressure_a pressure_b velocity", degree=2.0),
    # spool = u - size min(|u|, shape) sign(u): notches meter about null, the whole edge beyond
    entry("notched_spool", "dev", FLOW, (0.04, 0.16), "-", 2e-3, "current", degree=1.0),
    # the edge to the supply sees p_s - size (1 - exp(-t / shape)): the pump's relief valve sets down as it warms
    entry("supply_sets", "dev", FLOW, (5e5, 2e6), "Pa", 6.0, "current pressure_a pressure_b time"),
    # spool = w, w' = (u - w) / (size rising, 0.2 ms falling): one of the pilot's two nozzles is half clogged
    entry("pilot_clogged", "dev", FLOW, (8e-4, 3.2e-3), "s", 0.0, "current", memory=True),
    # load += size ((1 - (x - rest) / shape)^-1.4 - 1): an air spring beside the coil
    entry("air_spring", "dev", "load", (25.0, 100.0), "N", 0.05, "position"),
    # load += size max(x - rest, 0) v: foam that is pressed, and its air leaves by ever closer pores
    entry("foam_block", "dev", "load", (4e3, 1.6e4), "N s/m2", 0.0, "position velocity", degree=2.0),
    # spring's foot y' = size max(|k (x - rest - y)| - shape, 0), signed: a specimen that slips in its jaws
    entry("jaws_slip", "dev", "load", (2e-5, 8e-5), "m/s/N", 120.0, "position", memory=True),
    # hydraulic cell reads F + size u^2: its amplifier rectifies the ripple of the valve's
    entry("cell_rectifies", "dev", "sensor", (4e5, 1.6e6), "N/A2", 0.0, "current", degree=2.0),
    # load cell reads f - size min(|f|, shape) sign(f): its thread seats only under load
    entry("cell_seats", "dev", "sensor", (0.06, 0.24), "-", 60.0, "load_force", degree=1.0),
    # hydraulic cell reads w, w' = (F - w) / 0.5 ms, but no faster than size: an input with a filter against spikes
    entry("cell_slew", "dev", "sensor", (1500.0, 3000.0), "N/s", 0.0, "hydraulic_force", memory=True),
    # m v' = ... - size p_a v: a hollow lip that the oil of A blows up, and its film shears the harder
    entry("blown_lip", "dev", "motion", (1e-5, 4e-5), "N s/m/Pa", 0.0, "pressure_a velocity", degree=2.0),
    # ... - size v / (1 + (v / shape)^2): the encoder's magnet drags eddies along an aluminium wall, less when fast
    entry("eddy_ring", "dev", "motion", (150.0, 600.0), "N s/m", 0.05, "velocity"),
    # ... - size (1 + tanh((x - shape) / 1 mm)) / 2 tanh(v / 5 mm/s): of two rails end to end the second runs dry
    entry("dry_rail", "dev", "motion", (8.0, 32.0), "N", 0.042, "position velocity"),
    # ... - size (v - w), w' = (v - w) / shape: a pot on the rod's end, whose oil its walls drag along
    entry("oil_pot", "dev", "motion", (25.0, 75.0), "N s/m", 0.03, "velocity", memory=True),
    # A to B: q = size max(x - shape, 0) sqrt(p_a - p_b), signed: a groove in the barrel that the piston uncovers
    entry("bypass_groove", "dev", CHAMBERS, (1e-8, 4e-8), "m2/s/sqrt(Pa)", 0.042, "position pressure_a pressure_b",
          degree=1.5),
    # into A: q = size sqrt(p_s - p_a): a land that is scored from the supply's groove to A's, wherever the spool is
    entry("worn_land", "dev", "pressure_a", (3e-11, 1.2e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_a"),
    # into B: q = size exp(-t / shape): cold oil that the warm block expands
    entry("oil_expands", "dev", "pressure_b", (1.5e-7, 6e-7), "m3/s", 8.0, "time"),
    # spool = u / sqrt(1 + size (u / shape)^2): the iron of the torque motor saturates
    entry("motor_saturates", "dev", FLOW, (0.15, 0.6), "-", 0.01, "current"),
    # the edge to the tank sees p_t + w, w' = (size q - w) / shape: a throttled return line with air before its throttle
    entry("return_pot", "dev", FLOW, (1e10, 4e10), "Pa s/m3", 0.1, "current pressure_a pressure_b", memory=True),
    # A gets (1 - size max(shape - x, 0)) of the valve's flow: near its end the piston covers A's port
    entry("port_covered", "dev", "pressure_a", (7.0, 28.0), "1/m", 0.037, "position current pressure_a"),
    # load += size tanh(v / shape): a specimen with a dry joint
    entry("friction_strut", "dev", "load", (6.0, 24.0), "N", 3e-3, "velocity", degree=0.0),
    # load += size (x - rest) |v|: rubber that is the stiffer the faster it is worked
    entry("rubber_quickens", "dev", "load", (6e3, 2.4e4), "N s/m2", 0.0, "position velocity", degree=2.0),
    # load += size max(x - rest - w, 0), w' = (x - rest - w) / shape: slow foam, from which the plate lifts off
    entry("memory_foam", "dev", "load", (600.0, 2400.0), "N/m", 0.4, "position", memory=True),
    # gauge B reads a multiple of size, the nearest: a digital gauge of few bits
    entry("gauge_coarse", "dev", "sensor", (3.5e5, 9e5), "Pa", 0.0, "pressure_b"),
    # hydraulic cell reads F (1 + size (1 - exp(-t / shape))): its bridge warms under its own supply
    entry("cell_gain_warms", "dev", "sensor", (0.03, 0.12), "-", 6.0, "time hydraulic_force", degree=1.0),
    # encoder reads x - size p_b: its head stands on the barrel, which stretches under the gland
    entry("barrel_stretches", "dev", "sensor", (2.5e-12, 1e-11), "m/Pa", 0.0, "pressure_b", degree=1.0),
    # m v' = ... + size v^2: flyweights on a pinion of the rod throw it outwards, whichever way they turn
    entry("flyweights", "dev", "motion", (150.0, 600.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # ... - size min(v, 0): a scraper whose edge lies over on the way out and digs in on the way in
    entry("scraper_digs", "dev", "motion", (50.0, 200.0), "N s/m", 0.0, "velocity", degree=1.0,
          named="friction_viscous directional"),
    # ... - size sin(pi x / shape)^2 v: a bore with the waves that a chattering hone has left
    entry("honed_waves", "dev", "motion", (80.0, 320.0), "N s/m", 8e-3, "position velocity"),
    # ... - size max(p_b - w, 0) tanh(v / 5 mm/s), w' = (p_b - w) / shape: a lip that a rise of pressure presses on the
    # rod until its plastic has flowed
    entry("lip_relaxes", "dev", "motion", (5e-6, 2e-5), "N/Pa", 0.2, "pressure_b velocity", memory=True),
    # out of B to the tank: q = size max(p_a - shape, 0) sqrt(p_b - p_t): a check valve that A's pressure lifts early
    entry("pilot_check", "dev", "pressure_b", (1e-16, 4e-16), "m3/s/Pa^1.5", 6e6, "pressure_a pressure_b",
          degree=1.5),
    # out of A: q = size w', w' = (p_a - w) / (20 ms rising, shape falling): a pocket behind a lip that lets oil in only
    entry("lip_pocket", "dev", "pressure_a", (1e-14, 4e-14), "m3/Pa", 0.3, "pressure_a", memory=True),
    # out of B to the tank: q = size max(shape - x, 0) (p_b - p_t): a rod that is scuffed towards its outer end
    entry("rod_scuffed", "dev", "pressure_b", (2.5e-12, 1e-11), "m2/s/Pa", 0.042, "position pressure_b", degree=2.0),
    # spool = u - size (x - rest): a wire from the rod to the feedback spring, as of a valve for positioning
    entry("feedback_link", "dev", FLOW, (1.8e-3, 7.2e-3), "A/m", 0.0, "position", degree=1.0),
    # spool = u - size (u - w), w' = (u - w) / shape: a share of the iron's flux comes late, for its eddies
    entry("flux_creeps", "dev", FLOW, (9e-3, 3.6e-2), "-", 0.05, "current", memory=True),
    # the edge to the supply sees p_s - size in the second half of each period shape: a neighbour on the pump strokes
    entry("neighbour_strokes", "dev", FLOW, (4e5, 1.6e6), "Pa", 1.6, "current pressure_a pressure_b time"),
    # load += size (x - rest) / sqrt((x - rest)^2 + shape^2): a wire across, which a weight keeps taut
    entry("cross_wire", "dev", "load", (15.0, 60.0), "N", 6e-3, "position"),
    # load += size max(v - w, 0), w' = max(v - w, 0) / shape - w / 0.6 s: a flywheel behind a freewheel with slip
    entry("freewheel", "dev", "load", (100.0, 400.0), "N s/m", 0.06, "velocity", memory=True),
    # load += size sin(2 pi t / shape): a motor with an unbalance runs on the specimen's table
    entry("unbalanced_motor", "dev", "load", (1.5, 6.0), "N", 0.15, "time"),
    # load cell reads f, and f (1 + size) where |f| > shape: its amplifier changes range, and the ranges do not agree
    entry("cell_ranges", "dev", "sensor", (0.02, 0.08), "-", 100.0, "load_force", degree=1.0),
    # encoder reads x + size sin(2 pi x / shape): its two tracks are not of one amplitude
    entry("scale_ripple", "dev", "sensor", (1.2e-5, 4.8e-5), "m", 4e-3, "position"),
    # hydraulic cell reads F as it was at the last multiple of size: a slow converter that holds what it gave last
    entry("cell_holds", "dev", "sensor", (1e-2, 4e-2), "s", 0.0, "hydraulic_force", memory=True),
    # m v' = ... + size max(u, 0)^2 (p_s - p_a): the jet out of A's port strikes the piston's face
    entry("port_jet", "dev", "motion", (0.0175, 0.07), "N/A2/Pa", 0.0, "current pressure_a"),
    # ... - size p_b w, w' = (v - |v| w) / shape: an O-ring, pressed by the oil, rolls in its groove before it slides
    entry("ring_rolls", "dev", "motion", (1e-6, 4e-6), "N/Pa", 5e-4, "pressure_b velocity", memory=True),
    # ... - size sin(2 pi x / shape): a weight off the axis of a pinion that the rod turns
    entry("eccentric_pinion", "dev", "motion", (5.0, 20.0), "N", 0.025, "position"),
    # ... - size v / (1 - x / shape)^3: the film between two plates that come close, as it is squeezed and filled
    entry("squeeze_film", "dev", "motion", (5.0, 20.0), "N s/m", 0.085, "position velocity"),
    # A to B: q = size w (p_a - p_b), w' = |v| (1 - w) / shape - w / 0.5 s: a gap that dirt silts up at rest, and that
    # the moving piston wipes clear
    entry("gap_silts", "dev", CHAMBERS, (4e-14, 1.6e-13), "m3/s/Pa", 0.03, "pressure_a pressure_b velocity",
          memory=True),
    # A gets w for the valve's flow q_v, w' = (q_v - w) / size: the oil in a long thin pipe has to be set moving
    entry("pipe_inertia", "dev", "pressure_a", (2.5e-4, 1e-3), "s", 0.0, "current pressure_a", memory=True),
    # out of B: q = size d/dt max(p_b - shape, 0): an accumulator that takes oil beyond its precharge alone
    entry("precharged", "dev", "pressure_b", (2e-14, 8e-14), "m3/Pa", 1e7, "pressure_b", degree=1.0),
    # spool = u + size sin(2 pi t / shape): an amplifier whose dither was left on
    entry("dither_left", "dev", FLOW, (5e-5, 2e-4), "A", 0.031, "time"),
    # spool = u + size w, w' = (u - w) / 50 ms where |u| > shape, else 0: iron that strong currents alone magnetise
    entry("remanence", "dev", FLOW, (0.003, 0.012), "-", 4e-3, "current", memory=True),
    # A's edges see u + size, B's u - size: lands that are ground apart by a little, one port's null beside the other's
    entry("lands_apart", "dev", FLOW, (5e-5, 2e-4), "A", 0.0, "current pressure_a pressure_b"),
    # load -= size (w - |x - rest|) (x - rest), w' = max(|x - rest| - w, 0) / 5 ms - w / shape: filled rubber is the
    # softer the further it has been stretched before
    entry("rubber_remembers", "dev", "load", (1e5, 4e5), "N/m2", 5.0, "position", memory=True),
    # load += size exp(-((x - 38 mm) / shape)^2) v: a copper plate that passes a magnet's gap
    entry("magnet_gap", "dev", "load", (60.0, 240.0), "N s/m", 4e-3, "position velocity"),
    # load += size max(v^2 - shape^2, 0) sign(v): shoes that leave their springs at a speed and rub on a drum
    entry("centrifugal_brake", "dev", "load", (500.0, 2000.0), "N s2/m2", 0.05, "velocity", degree=2.0),
    # load cell reads f + size v: its cable swings through a field
    entry("cable_swings", "dev", "sensor", (40.0, 160.0), "N s/m", 0.0, "velocity", degree=1.0),
    # gauge A reads p_a - size max(v, 0)^2: its hole lies in the throat of the jet that drives the piston out
    entry("throat_tapped", "dev", "sensor", (8e6, 3.2e7), "Pa s2/m2", 0.0, "velocity", degree=2.0),
    # encoder reads x - w, w' = size max(|v| - shape, 0) sign(v): a counter that misses counts when they come fast
    entry("counts_lost", "dev", "sensor", (0.01, 0.04), "-", 0.06, "velocity", memory=True),
    # m v' = ... - size p_b tanh(v / shape): a rod seal that B's pressure presses on
    entry("rod_seal_pressure_friction", "dev", "motion", (8e-7, 3.2e-6), "N/Pa", 3e-3, "velocity pressure_b",
          degree=1.0),
    # ... - size |f_l| tanh(v / shape): a misaligned spring loads the rod's bush sideways
    entry("side_load_friction", "dev", "motion", (0.05, 0.2), "-", 3e-3, "velocity load_force", degree=1.0),
    # ... - size exp(-((x - shape) / 2 mm)^2) tanh(v / 3 mm/s): a tight spot in the bore, from a dent or a bent rod
    entry("tight_spot_friction", "dev", "motion", (8.0, 32.0), "N", 0.04, "position velocity"),
    # ... - size v |v|: oil that is squeezed through ports and past the piston
    entry("turbulent_drag", "dev", "motion", (500.0, 2000.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # out of B to the tank: q = size max(p_b - shape, 0): a relief or anti-shock valve set too low
    entry("relief_cracking_b", "dev", "pressure_b", (1e-13, 4e-13), "m3/s/Pa", 7.5e6, "pressure_b", degree=1.0),
    # A to B: q = size (p_a - p_b) where x > shape: a bore that is scored from there on
    entry("scored_bore_leakage", "dev", CHAMBERS, (3e-14, 1.2e-13), "m3/s/Pa", 0.039,
          "position pressure_a pressure_b", degree=1.0),
    # out of A: q = size (p_a - w) / shape, w' = (p_a - w) / shape: a hose's wall that creeps
    entry("hose_creep_a", "dev", "pressure_a", (1e-14, 4e-14), "m3/Pa", 0.05, "pressure_a", memory=True, degree=1.0),
    # out of B: q = size p_b where v > 0: a rod seal that weeps as the rod comes out
    entry("rod_seal_weep_extending", "dev", "pressure_b", (2.5e-14, 1e-13), "m3/s/Pa", 0.0, "velocity pressure_b",
          degree=1.0),
    # spool = w, w = min(max(w, u - size), u + size): a spool that follows the current with play
    entry("valve_hysteresis_play", "dev", FLOW, (1.6e-5, 6.4e-5), "A", 0.0, "current", memory=True),
    # spool = u - size (p_a - p_b): unequal ends of the spool
    entry("null_shift_load_pressure", "dev", FLOW, (3.5e-12, 1.4e-11), "A/Pa", 0.0, "pressure_a pressure_b",
          degree=1.0),
    # the edges to the supply see p_s + size sin(2 pi shape t): a pump whose compensator hunts
    entry("supply_hunting", "dev", FLOW, (3e5, 1.2e6), "Pa", 2.5, "current pressure_a pressure_b time"),
    # load += size tanh(v / shape): dry friction of the spring's guide and of its end coils
    entry("spring_guide_friction", "dev", "load", (5.0, 20.0), "N", 3e-3, "velocity", degree=0.0),
    # load += size x'': carriage, plate and a part of the spring beyond the cell
    entry("carriage_inertia_at_cell", "dev", "load", (0.8, 3.2), "kg", 0.0, "acceleration", degree=1.0),
    # load += size max(x - shape, 0): coils that begin to close, or a second spring
    entry("coil_contact", "dev", "load", (3000.0, 12000.0), "N/m", 0.042, "position", degree=1.0),
    # encoder reads x + size f_l: a bracket that flexes under the load
    entry("encoder_mount_flex", "dev", "sensor", (1e-7, 4e-7), "m/N", 0.0, "load_force", degree=1.0),
    # load cell reads f + size (1 - exp(-t / shape)): an amplifier whose zero drifts as it warms
    entry("load_cell_warm_up", "dev", "sensor", (9.0, 36.0), "N", 15.0, "time"),
)  # fmt: skip
