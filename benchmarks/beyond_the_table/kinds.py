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
    _kind("seal_drop", "sealed", "motion", (1.5e-6, 4e-6), "N/Pa", 2e-3, "pressure_a pressure_b velocity", degree=1.0),
    # ... - size max(x - shape, 0) v: a throttle that closes towards the end
    _kind("cushion_damping", "sealed", "motion", (2e4, 8e4), "N s/m2", 0.043, "position velocity", degree=2.0),
    # ... - size exp(-w) v, w' = |v| / shape - w / 10 s: oil thins as it warms
    _kind("oil_heat", "sealed", "motion", (80.0, 250.0), "N s/m", 0.25, "velocity", memory=True),
    # spool' = u - spool at 300 Hz, but no faster than size
    _kind("spool_rate", "sealed", _FLOW, (0.2, 0.4), "A/s", 300.0, "current", memory=True),
    # sqrt(dp) becomes dp / sqrt(|dp| + size): laminar below, turbulent above
    _kind("flow_transition", "sealed", _FLOW, (4e5, 2e6), "Pa", 0.0, "current pressure_a pressure_b"),
    # q = size (p_a - p_b) while the piston moves out: a lip that opens one way
    _kind("leak_by_motion", "sealed", _CHAMBERS, (6e-14, 2e-13), "m3/s/Pa", 2e-3, "pressure_a pressure_b velocity",
          degree=1.0),
    # foot y of the spring: y' = (size load / k - y) / shape
    _kind("flexible_mount", "sealed", "load", (0.02, 0.08), "-", 0.08, "position", memory=True),
    # hydraulic cell reads F + size F^2
    _kind("cell_curve", "sealed", "sensor", (3e-5, 1.2e-4), "1/N", 0.0, "hydraulic_force", degree=2.0),
)  # fmt: skip
NAMES = tuple(kind.name for kind in KINDS)
"""Compiled code knows a kind by its place here; -1 is none."""
HALVES = ("dev", "sealed")
