# SPDX-License-Identifier: Apache-2.0
"""What is concealed in each case, and what must be said about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Truth = Mapping[str, float]
Causes = Mapping[str, Mapping[str, float]]
"""Values by parameter, by cause; a cause is its id and, after a space, the part that it names."""
KINDS = {
    "clean": "nothing concealed",
    "single": "one cause of the table",
    "pair": "two causes of the table",
    "Stribeck": "friction that rises at standstill",
    "outside": "a cause that the table does not have",
    "late": "the log holds each row's current a row late",
    "unusable": "the bench swings from stop to stop",
    "later": "one cause of the table, not in the first run",
    "Stribeck later": "friction that rises at standstill, not in the first run",
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One concealed truth."""

    name: str
    kind: str
    truth: Truth = field(default_factory=dict)
    """Fields of `Numbers` that differ from bench.yaml."""
    causes: Causes = field(default_factory=dict)
    """What must be named, with the true values."""
    equation: str = ""
    """Where a remainder must be located, for a cause outside of the table."""
    table: bool = False
    """Recorded as CSV."""
    noise: float = 1.0
    """Times the standard noise."""
    box: Truth = field(default_factory=dict)
    """Fields in which the box believes something else than bench.yaml."""
    rows_late: int = 0


def _one(name: str, truth: Truth, values: Mapping[str, float], cause: str = "", kind: str = "single",
         table: bool = False, **others: Truth) -> Case:  # fmt: skip
    return Case(name=name, kind=kind, truth=truth, causes={cause or name: values}, table=table, **others)  # type: ignore[arg-type]


def _pair(name: str, truth: Truth, table: bool = False, **causes: Mapping[str, float]) -> Case:
    return Case(name=name, kind="pair", truth=truth, causes=causes, table=table)


def _stribeck(
    name: str, level: float, rise: float, velocity: float, kind: str = "Stribeck", table: bool = False
) -> Case:
    causes = {"friction_coulomb": {"force": level}} if level else {}
    causes["friction_stribeck"] = {"breakaway_force": rise, "velocity": velocity}
    truth = {"coulomb": level, "stribeck": rise, "stribeck_velocity": velocity}
    return Case(name=name, kind=kind, truth=truth, causes=causes, table=table)


def _outside(name: str, truth: Truth, equation: str) -> Case:
    return Case(name=name, kind="outside", truth=truth, equation=equation)


_MODULUS, _SUPPLY, _FLOW = 1.34e9, 16e6, 1.67e-4
_ASYMMETRY = {"valve_asymmetry": 1.06}

CASES: tuple[Case, ...] = (
    Case(name="clean_bag", kind="clean"),
    Case(name="clean_csv", kind="clean", table=True),
    Case(name="clean_noise_4", kind="clean", noise=4.0),
    Case(name="clean_noise_0.2", kind="clean", noise=0.2),
    _one("valve_deadband", {"valve_overlap": 3e-4}, {"half_width": 3e-4}),
    _one("valve_lag", {"spool_bandwidth": 90.0}, {"bandwidth": 90.0, "damping": 0.8}),
    _one("valve_lag_limited", {"spool_bandwidth": 110.0, "spool_damping": 1.0, "spool_rate": 1.2},
         {"bandwidth": 110.0, "damping": 1.0}, "valve_lag"),
    _one("valve_offset", {"valve_offset": 2e-4}, {"current": 2e-4}, table=True),
    _one("valve_gain", {"valve_gain": 0.95}, {"ratio": 0.95}),
    _one("asymmetry_0.94", {"valve_asymmetry": 0.94}, {"ratio": 0.94}, "valve_gain_asymmetry"),
    _one("asymmetry_1.06_told", _ASYMMETRY, {"ratio": 1.06}, "valve_gain_asymmetry",
         box={"valve_nominal_flow": 1.25 * _FLOW}),
    _one("transport_delay", {"valve_delay": 1.3e-3}, {"time": 1.3e-3}),
    _one("supply_droop", {"droop_resistance": 1.5e10, "droop_time": 0.04},
         {"resistance": 1.5e10, "time_constant": 0.04}),
    _one("supply_pressure", {"supply_pressure": 15.5e6}, {"ratio": 15.5e6 / _SUPPLY}, table=True),
    _one("bulk_modulus", {"bulk_modulus": 0.93 * _MODULUS}, {"ratio": 0.93}),
    _one("entrained_air", {"air": 0.006}, {"volume_fraction": 0.006}),
    _one("leakage_internal", {"leak_internal": 6e-14}, {"coefficient": 6e-14}),
    _one("leakage_external_a", {"leak_a": 4e-14}, {"coefficient": 4e-14}, "leakage_external a"),
    _one("friction_coulomb", {"coulomb": 8.0}, {"force": 8.0}, table=True),
    _one("friction_viscous", {"viscous_friction": 85.0}, {"coefficient": 25.0}),
    _one("moving_mass", {"moving_mass": 1.35}, {"mass": 0.15}),
    _one("spring_hardening", {"spring_cubic": 4e6}, {"coefficient": 4e6}),
    _one("backlash", {"backlash": 2e-4}, {"width": 2e-4}),
    _one("load_cell_gain", {"load_cell_gain": 1.03}, {"ratio": 1.03}, "load_cell_gain load_force"),
    _one("pressure_bias_b", {"gauge_b_bias": 4e4}, {"pressure": 4e4}, "pressure_sensor_bias b"),
    _pair("leak_coulomb", {"leak_internal": 6e-14, "coulomb": 9.0},
          leakage_internal={"coefficient": 6e-14}, friction_coulomb={"force": 9.0}),
    _pair("offset_hardening", {"valve_offset": -2e-4, "spring_cubic": 5e6}, table=True,
          valve_offset={"current": -2e-4}, spring_hardening={"coefficient": 5e6}),
    _pair("air_viscous", {"air": 0.005, "viscous_friction": 80.0},
          entrained_air={"volume_fraction": 0.005}, friction_viscous={"coefficient": 20.0}),
    _pair("deadband_lag", {"valve_overlap": 2e-4, "spool_bandwidth": 110.0, "spool_damping": 1.0},
          valve_deadband={"half_width": 2e-4}, valve_lag={"bandwidth": 110.0, "damping": 1.0}),
    _stribeck("stribeck", 8.0, 6.0, 0.012),
    _stribeck("stribeck_slow", 8.0, 6.0, 0.04),
    _stribeck("stribeck_only", 0.0, 8.0, 0.012),
    _stribeck("stribeck_csv", 8.0, 4.0, 0.02, table=True),
    _outside("seal_friction", {"seal_friction": 1.5e-6}, "motion"),
    _outside("valve_play", {"valve_play": 4e-4}, "actuation"),
    _outside("cogging", {"cogging": 8.0}, "motion"),
    _outside("flow_force", {"flow_force": 5e-9}, "actuation"),
    Case(name="current_a_row_late", kind="late", equation="actuation", rows_late=1),
    Case(name="asymmetry_1.06", kind="unusable", truth=_ASYMMETRY),
    _one("dead_volume_a", {"dead_volume_a": 2.2e-4}, {"ratio": 1.1}, "dead_volume a", "later"),
    _one("leakage_external_b", {"leak_b": 5e-14}, {"coefficient": 5e-14}, "leakage_external b", "later"),
    _one("spring_stiffness", {"spring_stiffness": 19400.0}, {"ratio": 0.97}, kind="later"),
    _one("spring_rest", {"spring_rest_position": 0.0404}, {"position": 0.0404}, kind="later"),
    _one("area_ratio", {"area_ratio": 0.98 * 0.609}, {"ratio": 0.98}, kind="later"),
    _one("tank_pressure", {"tank_pressure": 2e5}, {"pressure": 2e5}, kind="later"),
    _one("force_offset", {"force_offset": 5.0}, {"force": 5.0}, kind="later"),
    _one("end_cushion", {"cushion_stiffness": 8e3, "cushion_position": 0.046},
         {"stiffness": 8e3, "position": 0.046}, "end_cushion end", "later"),
    _one("valve_gain_drift", {"valve_gain_drift": -2e-3}, {"rate": -2e-3}, kind="later"),
    _one("load_cell_bias", {"load_cell_bias": 4.0}, {"force": 4.0}, "load_cell_bias load_force", "later", table=True),
    _one("pressure_bias_a", {"gauge_a_bias": -5e4}, {"pressure": -5e4}, "pressure_sensor_bias a", "later"),
    *(_stribeck(f"stribeck_{level:g}_{rise:g}_{1e3 * velocity:g}", level, rise, velocity, "Stribeck later")
      for level, rise, velocity in ((10.0, 5.0, 0.02), (5.0, 4.0, 0.03), (0.0, 6.0, 0.03), (12.0, 8.0, 0.015),
                                    (6.0, 3.0, 0.05), (15.0, 10.0, 0.01))),
)  # fmt: skip
