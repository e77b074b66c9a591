# SPDX-License-Identifier: Apache-2.0
"""Loop of a bench file for the certificate, and the check whether a bench has one.

Two models stand behind it, both compiled from the bench file::

    whole   all effects: for predictions, hidden states and the monitor
    loop    without `DISTURBANCES`: linearized, by its exact Jacobian

Dry friction, as an effect or a closure, overlap and gaps are bounded disturbances to the metric: within them nothing
moves, and a derivative there does not describe the loop. The certificate counts what of the current passes an overlap
(`overlap`).

The certificate has eight coordinates, and further ones for dead times and lagging pressure sensors
(`terms`). Effects without a place among them are refused: a second lag of the valve or of one sensor. Other
hidden states (bristles, a drooping supply) are held fixed in derivatives by x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray, StateArray, to_matrix
from hydro_filter.model.coordinates import LOOP_FIELDS, Q_SPOOL_RATE, coordinate_scales, gain_lower_bound
from hydro_filter.model.records import LOOP, SAMPLE, make_record
from hydro_filter.model.sample import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES
from hydro_filter.model.terms import (
    UNCERTAINTY,
    added_coordinates,
    count_delayed_currents,
    dead_time_samples,
    depends_on_velocity,
    hidden_state_indices,
    load_cell_coefficients,
    load_cell_indices,
    load_curve,
    null_shifts,
    pressure_observer,
    sensor_calibration,
    state_index,
    valve_lag_time,
)
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.firmware import BENCH_FIELDS, Records
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.grammar import depends_on_direction, has_hidden_states, signals_of
from hydro_sim.model.sensors import Sensors

DISTURBANCES = ("friction_coulomb", "friction_stribeck", "friction_presliding", "valve_deadband", "backlash")
"""Effects that the linearized loop leaves out."""

OVERLAP = "valve_deadband"
"""Of these, the one within which no current moves anything: B = 0."""

REFERENCE_ACCELERATION_MAX = 2000.0 / 3.0
"""1/s^2, limit of f_r'' over the bench's force: that at 4 Hz."""
VELOCITY_NOISE_FLOOR = 0.025
"""1/s, Velocity [m/s] over the stroke below which its sign is noise."""
FORCES_ALLOWED, PRESSURES_ALLOWED = np.array([0.025, 0.05, 0.04, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
"""What the monitor's equations may be off, whatever moves, over the bench's force: 2.5 %; dry friction; a cell's drift;
of pressures in `UNCERTAINTY`."""

MASS_FACTOR = 1e6
"""Mass within a sample over the bench's: hidden states follow the measured velocity, not what bristles make of it
within the sample, whose bend is unknown at first."""

SUBSTEPS = 4
"""Integration steps per sample: 250 us, a 44th of a period of the 90 Hz mass-on-oil mode."""

SINGLE_LAG_EFFECTS = {
    "the valve": "valve_lag",
    "the load cell": "sensor_lag sensor=load_force",
    "the load cell of f_h": "sensor_lag sensor=hydraulic_force",
    "the pressure sensor of a": "sensor_lag sensor=pressure_a",
    "the pressure sensor of b": "sensor_lag sensor=pressure_b",
}
"""Labels of effects of which a bench has one at most."""


@dataclass(frozen=True, eq=False)
class Loop:
    """Model of the force loop; `loop["whole.spool"]` is a field of hydro_loop (firmware/hydro/loop.h)."""

    truth: Bench
    """The bench file."""
    believed: Bench
    """What the box's force law believes."""
    values: dict[str, Any]
    """Fields of `record`, by name."""
    arrays: dict[str, npt.NDArray[Any]]
    """What its pointers point to, by name: `k`, `rest`, `forces`, `scale` and others."""
    record: Records
    """Of `records.LOOP`, shape (1,)."""

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    @property
    def scale(self) -> FloatArray:
        """Scale of each coordinate, shape (n,): the eight common ones, then those added."""
        return self.arrays["scale"]

    def __reduce__(self) -> tuple[Any, ...]:
        return make_loop, (self.truth, self.believed)


def make_loop(truth: Bench, believed: Bench) -> Loop:
    """Return the force loop of the bench file `truth` under a box configured for the bench `believed`.

    Raises ValueError: the certificate's coordinates cannot represent this bench; the message is one sentence.
    """
    check_representable(truth)
    values, arrays = _fields(truth, believed)
    return Loop(truth, believed, values, arrays, make_record(LOOP, values, arrays))


def check_representable(truth: Bench) -> None:
    """Raise ValueError if the certificate cannot represent one of a bench's effects or closures."""
    static = [one for one in truth.closures if not has_hidden_states(one)]
    loads: list[Mapping[str, Any]] = [{"id": "closure", **one} for one in static if one["equation"] == "load"]
    refused: dict[str, list[Mapping[str, Any]]] = {
        "what closures remember": [one for one in truth.closures if has_hidden_states(one)],
        "sensors that are not straight": [one for one in static if one["equation"] == "sensor"],
        "a mass that the load drags along": [one for one in loads if "acceleration" in signals_of(one)],
        "a load that follows the velocity": [one for one in loads if depends_on_velocity(truth, one)],
    }
    for what, closures in refused.items():
        if closures:
            forms = ", ".join(str(one["form"]) for one in closures)
            raise ValueError(
                f"the filter's certificate has no place for {what}: take {forms} out of the bench file, where it is "
                "small"
            )
    for what, label in SINGLE_LAG_EFFECTS.items():
        if sum(catalogue.label(effect).startswith(label) for effect in truth.effects) > 1:
            raise ValueError(f"the filter's certificate has a place for one lag of {what}, the bench file has more")


def closing_current(loop: Loop) -> float:
    """Return the current [A] that closes the valve, from the bench file's null shifts."""
    return -float(loop["before"] + loop["after"])


def coordinate_names(loop: Loop) -> tuple[str, ...]:
    """Return the names of the coordinates: `LOOP_FIELDS`, then those of the bench file's lags and dead time."""
    chambers = loop["lagging"]["chamber"][: loop["lagging_count"]]
    shown = [f"p_{'ab'[chamber]}_shown{ending}" for chamber in chambers for ending in ("", "_rate")]
    return (*LOOP_FIELDS, *shown, *(f"current_{i + 1}" for i in range(loop["on_their_way"])))


def input_coordinate(loop: Loop) -> int:
    """Return the index of the coordinate through which the current enters: the spool's rate, or the newest current."""
    return len(loop.scale) - loop["on_their_way"] if loop["on_their_way"] else Q_SPOOL_RATE


def rest_measurement(loop: Loop) -> FloatArray:
    """Return the measurement x, shape (8,), of the bench at rest, with gains and biases of its sensors."""
    y, x = loop.arrays["rest"], np.zeros(STATES)
    force = loop["area"] * (y[0] - loop["ratio"] * y[1])
    true = np.array([force, y[loop["whole.cell"]], *y[:3]])
    x[[HYDRAULIC_FORCE, LOAD_FORCE, PRESSURE_A, PRESSURE_B, POSITION]] = loop["gain"] * true + loop["bias"]
    return x


def make_samples(x: FloatArray, **signals: Any) -> Records:
    """Return records of `SAMPLE`, shape (n,), armed, from measurements x, shape (n, 8).

    `signals`: fields of the record, 0 otherwise; f_c and f_c' are f_r and f_r', C_1 and C_2 are 1.
    """
    samples = np.zeros(len(x), SAMPLE)
    samples["x"], samples["c_1"], samples["c_2"], samples["armed"] = x, 1.0, 1.0, True
    for name, values in signals.items():
        samples[name] = values
    samples["followed"], samples["followed_rate"] = samples["reference"], samples["reference_rate"]
    return samples


def recorded_samples(states: StateArray, velocity_compensation: float = 1.0) -> Records:
    """Return records of `SAMPLE` from a recorded run under a law with this C_1 and neutral coefficients."""
    names = ("nominal_valve_current", "valve_current", "reference_force", "reference_force_rate", "proportional_gain")
    fields = ("nominal", "current", "reference", "reference_rate", "k_p")
    signals = {field: states[name] for field, name in zip(fields, names, strict=True)}
    return make_samples(to_matrix(states), **signals, c_1=velocity_compensation)


def _fields(truth: Bench, believed: Bench) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """Fields of the record of a bench file, and what its pointers point to."""
    loop_bench, size, drive = without_disturbances(truth), believed.size, coordinate_scales(believed)
    whole, loop = BenchModel(truth, substeps=SUBSTEPS), BenchModel(loop_bench, substeps=SUBSTEPS)
    k, rest, _ = whole.begin(whole.values)
    carried = whole.values * [MASS_FACTOR if one.name == "moving_mass" else 1.0 for one in whole.parameters]
    places, loop_places = hidden_state_indices(truth), hidden_state_indices(loop_bench)
    numbers, past = truth.constants()[0], whole.structure.past
    chosen = [effect for effect in truth.terms if effect["id"] not in DISTURBANCES]
    from_whole = [*range(TEXTBOOK), *(places[name] for name in loop_places), *range(len(rest) - past, len(rest))]
    before, after = null_shifts(truth)
    lag, inertia = load_cell_coefficients(truth)
    added = added_coordinates(truth, places, loop_places, drive)
    count = len(added.lagging)
    sensors = np.column_stack((added.kept[: 2 * count].reshape(-1, 2), added.lagging[:, 2:]))
    lagging, observer = np.zeros(2, LOOP["lagging"].base), np.zeros((3, 6))
    for name, column in zip(("signal", "rate", "chamber"), added.lagging.T, strict=True):
        lagging[name][:count] = column
    lagging["age"][:count] = added.ages
    observer[: count + 1, : 3 * count] = pressure_observer(loop, sensors, size)
    positions: FloatArray = np.asarray(np.linspace(-0.05, 1.05, 1101) * float(numbers["stroke"]), np.float64)
    forces = load_curve(numbers, chosen, positions)
    if not (np.diff(forces) > 0.0).all():
        raise ValueError("the filter needs a load that rises with the piston's position over the whole stroke")
    dry = [
        effect["parameters"] for effect in truth.effects if effect["id"] in ("friction_coulomb", "friction_stribeck")
    ]
    level = sum(max(value for name, value in each.items() if "force" in name) for each in dry)
    bristles = any(effect["id"] == "friction_presliding" for effect in truth.effects)
    gain, bias = sensor_calibration(truth)
    area, believes = float(numbers["piston_area"]), believed.constants()[0]
    stiffness_a = hydraulics.stiffnesses(numbers, float(rest[2]))[0]
    values: dict[str, Any] = {
        "sample": whole.address_of("bench_sample"), "jacobian": loop.address_of("bench_jacobian"),
        "lagging": lagging, "observer": observer, "coordinates": len(drive) + len(added.scale), "points": len(forces),
        "lagging_count": count, "past": past, "at_valve": dead_time_samples(truth),
        "on_their_way": count_delayed_currents(truth), "holds": level > 0.0 and not bristles, "level": level,
        "force_shown": state_index(places, "sensor_lag sensor=hydraulic_force", "signal"),
        "first": positions[0], "step": positions[1] - positions[0], "before": before, "after": after,
        "delay": catalogue.total_delay(truth.effects), "spool_age": valve_lag_time(truth), "lag": lag,
        "inertia": inertia,
        "gain": gain, "bias": bias,
        "allowed": size.force * FORCES_ALLOWED + size.pressure * UNCERTAINTY * PRESSURES_ALLOWED,
        "area": area, "ratio": float(numbers["area_ratio"]), "mass": float(numbers["moving_mass"]),
        "dead_a": float(numbers["dead_volume_a"]), "dead_b": float(numbers["dead_volume_b"]),
        "stroke": float(numbers["stroke"]), "bend_max": size.force * REFERENCE_ACCELERATION_MAX, "creep": size.length *
        VELOCITY_NOISE_FLOOR, "least_gain": gain_lower_bound(area, stiffness_a, float(numbers["valve_gain"]),
        float(numbers["supply_pressure"])), "least_opening": 0.1 * float(numbers["valve_current_max"]),
        "gain_floor": float(BoxConfig().constants(believed)["gain_floor"][0]),
        "velocity_memory": float(Sensors().constants()[0]["velocity_memory"]),
        "bench": tuple(float(believes[name]) for name in BENCH_FIELDS),
    }  # fmt: skip
    for name, model, numbered, of in (("whole", whole, places, truth), ("linear", loop, loop_places, loop_bench)):
        cell, cell_rate = load_cell_indices(of, numbered)
        values |= {
            f"{name}.rates": model.address_of("bench_rates"), f"{name}.states": len(model.states),
            f"{name}.spool": state_index(numbered, "valve_lag", "spool"),
            f"{name}.spool_rate": state_index(numbered, "valve_lag", "rate"),
            f"{name}.cell": cell, f"{name}.cell_rate": cell_rate,
        }  # fmt: skip
    arrays: dict[str, npt.NDArray[Any]] = {
        "whole.k": k, "linear.k": loop.begin(loop.values)[0], "sample_k": whole.begin(carried)[0],
        "from_whole": np.array(from_whole, np.int32), "rest": rest, "forces": forces,
        "scale": np.append(drive, added.scale), "kept": added.kept.astype(np.int32),
    }  # fmt: skip
    return values, arrays


def without_disturbances(truth: Bench) -> Bench:
    """Return the bench without `DISTURBANCES` and closures, which the linearization leaves out."""
    return replace(
        truth,
        effects=tuple(effect for effect in truth.effects if effect["id"] not in DISTURBANCES),
        closures=tuple(one for one in truth.closures if one["equation"] != "motion" or not depends_on_direction(one)),
    )


def without_overlap(truth: Bench) -> Bench | None:
    """Return the bench without its valve's overlap; None if it has none."""
    kept = tuple(effect for effect in truth.effects if effect["id"] != OVERLAP)
    return replace(truth, effects=kept) if len(kept) < len(truth.effects) else None


def valve_overlap(truth: Bench) -> dict[str, float]:
    """Return the overlap of a bench's valve [A], summed over its effects.

    `closing`: current that closes the valve; `back`, `out`: half widths of negative openings and of others.
    """
    closing, back, out = -sum(null_shifts(truth)), 0.0, 0.0
    for effect in truth.effects:
        if effect["id"] == OVERLAP:
            widths = effect["parameters"]
            out += float(widths["half_width"])
            back += float(widths.get("half_width_negative", widths["half_width"]))
    return {"closing": closing, "back": back, "out": out}
