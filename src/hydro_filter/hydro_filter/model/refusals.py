# SPDX-License-Identifier: Apache-2.0
"""Effects and closures of a bench file for which the filter's certificate has no place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_filter.model.terms import follows_velocity
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import catalogue
from hydro_sim.model.grammar import remembers, uses

ONE_LAG = {
    "the valve": "valve_lag",
    "the load cell": "sensor_lag sensor=load_force",
    "the load cell of f_h": "sensor_lag sensor=hydraulic_force",
    "the pressure sensor of a": "sensor_lag sensor=pressure_a",
    "the pressure sensor of b": "sensor_lag sensor=pressure_b",
}
"""Labels of effects of which a bench has one at most."""


def refuse(truth: Bench) -> None:
    """Raise ValueError, in one sentence, if the certificate has no place for one of a bench's effects or closures."""
    static = [one for one in truth.closures if not remembers(one)]
    loads: list[Mapping[str, Any]] = [{"id": "closure", **one} for one in static if one["equation"] == "load"]
    refused: dict[str, list[Mapping[str, Any]]] = {
        "what closures remember": [one for one in truth.closures if remembers(one)],
        "sensors that are not straight": [one for one in static if one["equation"] == "sensor"],
        "a mass that the load drags along": [one for one in loads if "acceleration" in uses(one)],
        "a load that follows the velocity": [one for one in loads if follows_velocity(truth, one)],
    }
    for what, closures in refused.items():
        if closures:
            forms = ", ".join(str(one["form"]) for one in closures)
            raise ValueError(
                f"the filter's certificate has no place for {what}: take {forms} out of the bench file, where it is "
                "small"
            )
    for what, label in ONE_LAG.items():
        if sum(catalogue.label(effect).startswith(label) for effect in truth.effects) > 1:
            raise ValueError(f"the filter's certificate has a place for one lag of {what}, the bench file has more")
