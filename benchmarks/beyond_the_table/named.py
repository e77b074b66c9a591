# SPDX-License-Identifier: Apache-2.0
"""The half `named`: what the table names, on the same plant: causes alone, four pairs, friction with a Stribeck rise.

By case: fields of `Numbers` that differ from bench.yaml, and the true values by parameter, by cause; a cause is its id
and, after a space, the part that it names.
"""

from __future__ import annotations

Values = dict[str, float]

SINGLE: dict[str, tuple[Values, str, Values]] = {
    "valve_deadband": ({"valve_overlap": 3e-4}, "valve_deadband", {"half_width": 3e-4}),
    "valve_lag": ({"spool_bandwidth": 90.0}, "valve_lag", {"bandwidth": 90.0, "damping": 0.8}),
    "valve_offset": ({"valve_offset": 2e-4}, "valve_offset", {"current": 2e-4}),
    "valve_gain": ({"valve_gain": 0.95}, "valve_gain", {"ratio": 0.95}),
    "asymmetry": ({"valve_asymmetry": 0.94}, "valve_gain_asymmetry", {"ratio": 0.94}),
    "transport_delay": ({"valve_delay": 1.3e-3}, "transport_delay", {"time": 1.3e-3}),
    "supply_droop": ({"droop_resistance": 1.5e10, "droop_time": 0.04}, "supply_droop",
                     {"resistance": 1.5e10, "time_constant": 0.04}),
    "supply_pressure": ({"supply_pressure": 15.5e6}, "supply_pressure", {"ratio": 15.5 / 16.0}),
    "bulk_modulus": ({"bulk_modulus": 0.93 * 1.34e9}, "bulk_modulus", {"ratio": 0.93}),
    "entrained_air": ({"air": 0.006}, "entrained_air", {"volume_fraction": 0.006}),
    "leakage_internal": ({"leak_internal": 6e-14}, "leakage_internal", {"coefficient": 6e-14}),
    "leakage_a": ({"leak_a": 4e-14}, "leakage_external a", {"coefficient": 4e-14}),
    "leakage_b": ({"leak_b": 5e-14}, "leakage_external b", {"coefficient": 5e-14}),
    "friction_coulomb": ({"coulomb": 8.0}, "friction_coulomb", {"force": 8.0}),
    "friction_viscous": ({"viscous_friction": 85.0}, "friction_viscous", {"coefficient": 25.0}),
    "moving_mass": ({"moving_mass": 1.35}, "moving_mass", {"mass": 0.15}),
    "spring_hardening": ({"spring_cubic": 4e6}, "spring_hardening", {"coefficient": 4e6}),
    "backlash": ({"backlash": 2e-4}, "backlash", {"width": 2e-4}),
    "load_cell_gain": ({"load_cell_gain": 1.03}, "load_cell_gain load_force", {"ratio": 1.03}),
    "load_cell_bias": ({"load_cell_bias": 4.0}, "load_cell_bias load_force", {"force": 4.0}),
    "gauge_a_bias": ({"gauge_a_bias": -5e4}, "pressure_sensor_bias a", {"pressure": -5e4}),
    "gauge_b_bias": ({"gauge_b_bias": 4e4}, "pressure_sensor_bias b", {"pressure": 4e4}),
    "dead_volume_a": ({"dead_volume_a": 2.2e-4}, "dead_volume a", {"ratio": 1.1}),
    "spring_stiffness": ({"spring_stiffness": 19400.0}, "spring_stiffness", {"ratio": 0.97}),
    "spring_rest": ({"spring_rest_position": 0.0404}, "spring_rest", {"position": 0.0404}),
    "area_ratio": ({"area_ratio": 0.98 * 0.609}, "area_ratio", {"ratio": 0.98}),
    "tank_pressure": ({"tank_pressure": 2e5}, "tank_pressure", {"pressure": 2e5}),
    "force_offset": ({"force_offset": 5.0}, "force_offset", {"force": 5.0}),
    "end_cushion": ({"cushion_stiffness": 8e3, "cushion_position": 0.046}, "end_cushion end",
                    {"stiffness": 8e3, "position": 0.046}),
    "valve_gain_drift": ({"valve_gain_drift": -2e-3}, "valve_gain_drift", {"rate": -2e-3}),
}  # fmt: skip
PAIRS = (("leakage_internal", "friction_coulomb"), ("valve_offset", "spring_hardening"),
         ("entrained_air", "friction_viscous"), ("valve_deadband", "valve_lag"))  # fmt: skip
STRIBECK = ((8.0, 6.0, 0.012), (8.0, 6.0, 0.04), (0.0, 8.0, 0.012), (8.0, 4.0, 0.02), (10.0, 5.0, 0.02),
            (5.0, 4.0, 0.03), (0.0, 6.0, 0.03), (12.0, 8.0, 0.015), (6.0, 3.0, 0.05), (15.0, 10.0, 0.01))  # fmt: skip
"""Level and rise [N], velocity [m/s]."""


def named_causes() -> dict[str, tuple[Values, dict[str, Values]]]:
    """Of each case: what differs, and what must be named."""
    made = {name: (truth, {cause: values}) for name, (truth, cause, values) in SINGLE.items()}
    for pair in PAIRS:
        truths, causes = zip(*(made[name] for name in pair), strict=True)
        made["+".join(pair)] = truths[0] | truths[1], causes[0] | causes[1]
    for level, rise, velocity in STRIBECK:
        told: dict[str, Values] = {"friction_stribeck": {"breakaway_force": rise, "velocity": velocity}}
        told |= {"friction_coulomb": {"force": level}} if level else {}
        truth = {"coulomb": level, "stribeck": rise, "stribeck_velocity": velocity}
        made[f"stribeck_{level:g}_{rise:g}_{1e3 * velocity:g}"] = truth, told
    return made
