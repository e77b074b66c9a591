# SPDX-License-Identifier: Apache-2.0
"""The kinds of physics outside the table: where each lives, how large it is drawn and what its right form is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of physics that no effect id names."""

    name: str
    half: str
    """`dev`, which improvements may look at, or `sealed`."""
    equations: tuple[str, ...]
    """Where a report may locate it: ids of `location`."""
    size: tuple[float, float]
    """Range of its magnitude; drawn with either end equally likely, by logarithm."""
    unit: str
    shape: float
    """Its second number (a time, a position, a width), SI."""
    variables: frozenset[str]
    """What a law of the right form depends on, and nothing else."""
    memory: bool = False
    """Whether a law of the right form has a state of its own."""
    degree: float | None = None
    """Total power of the signals in the law, where the form is a monomial; signs and thresholds count nothing."""
    named: str = ""
    """Cause of the table that is this kind after all, as `id form`: found only once `diagnose` had named it."""


def _kind(name: str, half: str, equations: str, size: tuple[float, float], unit: str, shape: float, variables: str,
          memory: bool = False, degree: float | None = None, named: str = "") -> Kind:  # fmt: skip
    return Kind(name=name, half=half, equations=tuple(equations.split()), size=size, unit=unit, shape=shape,
                variables=frozenset(variables.split()), memory=memory, degree=degree, named=named)  # fmt: skip


_FLOW = "actuation pressure_a pressure_b"
_CHAMBERS = "pressure_a pressure_b"
KINDS: tuple[Kind, ...] = (
    # m v' = ... - size v |v|
    _kind("drag_square", "dev", "motion", (400.0, 1500.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # ... - size ((x - rest) / shape)^2 v: a bore that narrows away from its middle
    _kind("friction_position", "dev", "motion", (60.0, 200.0), "N s/m", 0.01, "position velocity", degree=3.0),
    # spool = u - size w, w' = (u' - |u'| w) / shape: magnetic hysteresis of a torque motor
    _kind("valve_hysteresis", "dev", _FLOW, (1.5e-4, 5e-4), "A", 3e-4, "current", memory=True),
    # spool = u (1 - size |u| / u_n): ports that narrow as they open (widening ones make the loop swing)
    _kind("valve_curve", "dev", _FLOW, (0.2, 0.5), "-", 0.05, "current", degree=2.0),
    # q = size sqrt(p_a - p_b), signed: a worn edge between the chambers
    _kind("leak_orifice", "dev", _CHAMBERS, (1.5e-10, 5e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_a pressure_b",
          degree=0.5, named="leakage_internal orifice"),
    # hose of chamber A: q = size (p_a - w) / shape, w' = (p_a - w) / shape
    _kind("hose_memory", "dev", "pressure_a", (1.5e-14, 5e-14), "m3/Pa", 0.15, "pressure_a", memory=True),
    # load += size w, w' = v / shape - |v| w / shape: the spring loads on one path and unloads on another
    _kind("spring_hysteresis", "dev", "load", (4.0, 15.0), "N", 2e-3, "position velocity", memory=True),
    # hydraulic cell reads F + size w, w' = (F - w) / shape
    _kind("cell_creep", "dev", "sensor", (0.06, 0.15), "-", 1.5, "hydraulic_force", memory=True),
    # ... - size |p_a - p_b| tanh(v / shape): a lip that the pressure presses on the rod
    _kind("seal_drop", "dev", "motion", (1.5e-6, 4e-6), "N/Pa", 2e-3, "pressure_a pressure_b velocity", degree=1.0),
    # ... - size max(x - shape, 0) v: a throttle that closes towards the end
    _kind("cushion_damping", "dev", "motion", (2e4, 8e4), "N s/m2", 0.043, "position velocity", degree=2.0),
    # ... - size exp(-w) v, w' = |v| / shape - w / 10 s: oil thins as it warms
    _kind("oil_heat", "dev", "motion", (80.0, 250.0), "N s/m", 0.25, "velocity", memory=True),
    # spool' = u - spool at 300 Hz, but no faster than size
    _kind("spool_rate", "dev", _FLOW, (0.2, 0.4), "A/s", 300.0, "current", memory=True),
    # sqrt(dp) becomes dp / sqrt(|dp| + size): laminar below, turbulent above
    _kind("flow_transition", "dev", _FLOW, (4e5, 2e6), "Pa", 0.0, "current pressure_a pressure_b"),
    # q = size (p_a - p_b) while the piston moves out: a lip that opens one way
    _kind("leak_by_motion", "dev", _CHAMBERS, (6e-14, 2e-13), "m3/s/Pa", 2e-3, "pressure_a pressure_b velocity",
          degree=1.0),
    # foot y of the spring: y' = (size load / k - y) / shape
    _kind("flexible_mount", "dev", "load", (0.02, 0.08), "-", 0.08, "position", memory=True),
    # hydraulic cell reads F + size F^2
    _kind("cell_curve", "dev", "sensor", (3e-5, 1.2e-4), "1/N", 0.0, "hydraulic_force", degree=2.0),
    # ... - size exp(-(w / 50 mm/s)^2) tanh(v / 2 mm/s), w' = (v - w) / shape: the film follows late
    _kind("friction_lag", "dev", "motion", (8.0, 30.0), "N", 0.02, "velocity", memory=True),
    # ... - size exp(-((x - 43 mm) / shape)^2) tanh(v / 2 mm/s): a scored length of the bore
    _kind("bore_score", "dev", "motion", (8.0, 30.0), "N", 3e-3, "position velocity"),
    # ... - size v / (1 + |v| / shape): oil whose long molecules align in a fast film
    _kind("shear_thinning", "dev", "motion", (100.0, 400.0), "N s/m", 0.03, "velocity"),
    # out of A to the tank: q = size max(p_a - shape, 0): a port relief valve set too low
    _kind("port_relief", "dev", "pressure_a", (2e-13, 8e-13), "m3/s/Pa", 6.3e6, "pressure_a", degree=1.0),
    # A to B: q = size (p_a - p_b) exp(-((x - 45 mm) / shape)^2): a barrel worn where it works most
    _kind("worn_bore", "dev", _CHAMBERS, (1e-13, 4e-13), "m3/s/Pa", 4e-3, "position pressure_a pressure_b"),
    # A to B: q = size w (p_a - p_b), w' = (|u| / u_n - w) / shape: throttled oil warms and the leak with it
    _kind("hot_leak", "dev", _CHAMBERS, (2e-12, 6e-12), "m3/s/Pa", 3.0, "current pressure_a pressure_b",
          memory=True),
    # out of B: q = size A_b max(v, 0): a grooved rod carries oil out, the scraper takes it off on the way in
    _kind("rod_film", "dev", "pressure_b", (0.01, 0.04), "-", 0.0, "velocity", degree=1.0),
    # spool = u - size max(u - shape, 0): a spring stop that the spool meets early on one side
    _kind("spool_stop", "dev", _FLOW, (0.2, 0.6), "-", 2.5e-3, "current", degree=1.0),
    # spool = u + size w, w' = (|u| / u_n - w) / shape: null moves as throttled oil warms the valve
    _kind("null_warms", "dev", _FLOW, (1e-3, 3e-3), "A", 4.0, "current", memory=True),
    # the edge to the tank sees p_t + size q^2: a clogged return filter
    _kind("return_filter", "dev", _FLOW, (5e14, 3e15), "Pa s2/m6", 0.0, "current pressure_a pressure_b"),
    # load += size max(x - shape, 0): a second spring, reached on the way
    _kind("stop_spring", "dev", "load", (1e3, 6e3), "N/m", 0.045, "position", degree=1.0),
    # load += size max(v, 0)^2: a shock absorber with a check valve
    _kind("rebound_damper", "dev", "load", (400.0, 1500.0), "N s2/m2", 0.0, "velocity", degree=2.0),
    # load += size k |x - rest| tanh(v / shape): leaves that rub the more the more they are bent
    _kind("leaf_spring", "dev", "load", (0.02, 0.08), "-", 5e-3, "position velocity", degree=1.0),
    # hydraulic cell reads F + size u: its cable lies beside the valve's
    _kind("cell_pickup", "dev", "sensor", (1000.0, 6000.0), "N/A", 0.0, "current", degree=1.0),
    # gauge B reads p_b + size (1 - exp(-t / shape)): its zero drifts until it is warm
    _kind("gauge_warms", "dev", "sensor", (8e4, 4e5), "Pa", 8.0, "time"),
    # gauge B reads w, w' = (p_b - w) / (0.5 ms rising, size falling): a snubber with a check valve
    _kind("gauge_snubber", "dev", "sensor", (5e-3, 2e-2), "s", 0.0, "pressure_b", memory=True),
    # ... - size p_b tanh(v / shape): the gland's lips, pressed on the rod by the oil that they hold
    _kind("gland_pressure", "sealed", "motion", (1e-6, 3.5e-6), "N/Pa", 2e-3, "pressure_b velocity", degree=1.0),
    # ... - size v / sqrt(|v| + shape): the film under a lip carries more the faster it is drawn, by the root
    _kind("lip_film", "sealed", "motion", (30.0, 120.0), "N/sqrt(m/s)", 1e-3, "velocity", degree=0.5),
    # ... - size (x - rest - w), w' = (x - rest - w) / shape: a bellows over the rod that breathes by a small hole
    _kind("rod_bellows", "sealed", "motion", (600.0, 3000.0), "N/m", 0.2, "position", memory=True),
    # ... - size exp(-t / shape) v: a bench that starts cold
    _kind("cold_start", "sealed", "motion", (150.0, 600.0), "N s/m", 8.0, "time velocity"),
    # out of B to the tank: q = size sqrt(p_b - p_t): a fitting that weeps
    _kind("weeping_fitting", "sealed", "pressure_b", (1.5e-10, 6e-10), "m3/s/sqrt(Pa)", 0.0, "pressure_b", degree=0.5),
    # B to A: q = size max(p_b - p_a - shape, 0): a lip that is lifted from its back
    _kind("blow_by", "sealed", _CHAMBERS, (2e-13, 1e-12), "m3/s/Pa", 3.8e6, "pressure_a pressure_b", degree=1.0),
    # A to B: q = size (1 - w^2) (p_a - p_b), w' = (v - |v| w) / shape: a ring that leaves its seat at each reversal
    _kind("floating_ring", "sealed", _CHAMBERS, (1.2e-13, 5e-13), "m3/s/Pa", 5e-4, "pressure_a pressure_b velocity",
          memory=True),
    # into B while the valve drives out: q = size K_v max(u, 0) sqrt(p_b - p_t): one edge of four is silted up
    _kind("silted_edge", "sealed", "pressure_b", (0.03, 0.12), "-", 0.0, "current pressure_b", degree=1.5),
    # spool = u / (1 + size dp), dp over both open edges: the jets close the valve against its spring
    _kind("jet_force", "sealed", _FLOW, (3e-9, 1e-8), "1/Pa", 0.0, "current pressure_a pressure_b"),
    # spool = u - size (p_a - p_b): the load's pressure leans on the spool
    _kind("load_null", "sealed", _FLOW, (1e-11, 4e-11), "A/Pa", 0.0, "pressure_a pressure_b", degree=1.0),
    # load += size v: a specimen that damps
    _kind("specimen_damping", "sealed", "load", (25.0, 120.0), "N s/m", 0.0, "velocity", degree=1.0),
    # load += size x'': a grip beyond the cell, its mass besides the piston's
    _kind("grip_mass", "sealed", "load", (0.8, 3.0), "kg", 0.0, "acceleration", degree=1.0),
    # load -= size w k (x - rest), w' = (|v| / 0.1 m/s - w) / shape: rubber softens as it is worked warm
    _kind("specimen_softens", "sealed", "load", (0.05, 0.15), "-", 4.0, "position velocity", memory=True),
    # load cell reads f + size max(-f, 0): a joint that passes part of a pull by the cell
    _kind("cell_bypass", "sealed", "sensor", (0.03, 0.1), "-", 0.0, "load_force", degree=1.0),
    # gauge B reads p_b - size max(p_b - shape, 0): its amplifier runs into its limit
    _kind("gauge_limit", "sealed", "sensor", (0.3, 1.0), "-", 1.15e7, "pressure_b", degree=1.0),
    # encoder reads x - size w, w' = (v - |v| w) / shape: play in its coupling
    _kind("encoder_play", "sealed", "sensor", (3e-5, 1e-4), "m", 3e-4, "position velocity", memory=True),
)  # fmt: skip
NAMES = tuple(kind.name for kind in KINDS)
"""Compiled code knows a kind by its place here; -1 is none."""
HALVES = ("dev", "sealed")
