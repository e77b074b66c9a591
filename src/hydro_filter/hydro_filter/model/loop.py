# SPDX-License-Identifier: Apache-2.0
"""Force-loop model of a bench file for the certificate, and the check that its coordinates can represent the bench.

The loop has two models, both compiled from the bench file::

    whole   all effects: for predictions, hidden states and the monitor
    loop    without `DISTURBANCE_EFFECTS`: linearized, by its exact Jacobian

Dry friction, as an effect or a closure, overlap and gaps are bounded disturbances to the metric: within them nothing
moves, and a derivative there does not describe the loop. The certificate counts the part of the current that passes an
overlap (`hydro_core.valve_overlap`).

The certificate has eight coordinates, and further ones for dead times and lagging pressure sensors
(`terms`). Effects without a coordinate are refused: a second lag of the valve or of one sensor. Other
hidden states (bristles, a drooping supply) are held fixed in derivatives by x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, floor, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLE_PERIOD, FloatArray, StateArray, to_matrix
from hydro_core.valve_overlap import OVERLAP_EFFECT, null_shifts
from hydro_filter.model import terms
from hydro_filter.model.coordinates import LOOP_FIELDS, Q_HYDRAULIC, Q_SPOOL, coordinate_scales
from hydro_filter.model.records import LOOP_DTYPE, SAMPLE_DTYPE, make_record
from hydro_filter.model.sample import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATE_SIZE
from hydro_sim.box.box import BoxConfig, believed_numbers
from hydro_sim.box.firmware import RecordArray
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK_STATE_COUNT, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.grammar import depends_on_direction, has_hidden_states, signals_of
from hydro_sim.model.sensors import Sensors

DISTURBANCE_EFFECTS = ("friction_coulomb", "friction_stribeck", "friction_presliding", OVERLAP_EFFECT, "backlash")
"""Effects left out of the linearized loop, as bounded disturbances."""
FORCE_ALLOWANCES, PRESSURE_ALLOWANCES = np.array([0.025, 0.05, 0.04, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
"""Residuals that the monitor's equations allow at any motion, shape (5,). Over the bench's force: model error of the
load, dry friction, a load cell's drift; over `terms.PRESSURE_UNCERTAINTY` of the bench's pressure: the chambers."""

SUBSTEPS = 4
"""Integration steps per sample: 250 us, a 44th of a period of the 90 Hz mass-on-oil mode."""
SINGLE_LAG_EFFECTS = {
    "the valve": terms.VALVE_LAG,
    "the load cell": terms.LOAD_CELL_LAG,
    "the load cell of f_h": terms.FORCE_CELL_LAG,
    "the pressure sensor of a": terms.PRESSURE_LAGS[0],
    "the pressure sensor of b": terms.PRESSURE_LAGS[1],
}
"""Labels of the lags of which a representable bench has at most one, by component."""
DEAD_TIME_TOLERANCE = 1e-9
"""Fraction of a sample within which a dead time counts as a whole number of samples."""


@dataclass(frozen=True, eq=False)
class Loop:
    """Model of the force loop; `loop["whole.spool"]` is a field of hydro_loop (firmware/hydro/loop.h)."""

    model_bench: Bench
    """The bench file."""
    box_bench: Bench
    """Bench that the box's force law is configured for."""
    values: dict[str, Any]
    """Fields of `record`, by name."""
    arrays: dict[str, npt.NDArray[Any]]
    """Arrays behind the record's pointers, by field name: `k`, `rest`, `forces`, `scale` and others."""
    record: RecordArray
    """Record of `records.LOOP_DTYPE`, shape (1,)."""

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    @property
    def scale(self) -> FloatArray:
        """Scale of each coordinate, shape (n,): the eight common ones, then those that the bench file adds."""
        return self.arrays["scale"]

    def __reduce__(self) -> tuple[Any, ...]:
        return make_loop, (self.model_bench, self.box_bench)


def make_loop(model_bench: Bench, box_bench: Bench) -> Loop:
    """Return the force loop of the bench file `model_bench` under a box configured for the bench `box_bench`.

    Raises ValueError: the certificate's coordinates cannot represent this bench; the message is one sentence.
    """
    check_representable(model_bench)
    # both models, and the indices of the linear model's states in the whole one
    linear_bench = without_disturbances(model_bench)
    whole, linear = BenchModel(model_bench, substeps=SUBSTEPS), BenchModel(linear_bench, substeps=SUBSTEPS)
    states, linear_states = terms.hidden_state_indices(model_bench), terms.hidden_state_indices(linear_bench)
    k, rest, _ = whole.begin(whole.values)
    # a heavy mass: hidden states follow the measured velocity, not what bristles of unknown deflection would cause
    carried = whole.values * [1e6 if one.name == "moving_mass" else 1.0 for one in whole.parameters]
    past = whole.structure.past_currents
    from_whole = [
        *range(TEXTBOOK_STATE_COUNT),
        *(states[name] for name in linear_states),
        *range(len(rest) - past, len(rest)),
    ]

    # load, friction, sensors and valve
    numbers, size = model_bench.constants()[0], box_bench.size
    positions: FloatArray = np.asarray(np.linspace(-0.05, 1.05, 1101) * float(numbers["stroke"]), np.float64)
    forces = terms.load_curve(
        numbers, [one for one in model_bench.terms if one["id"] not in DISTURBANCE_EFFECTS], positions
    )
    if not (np.diff(forces) > 0.0).all():
        raise ValueError("the filter needs a load that rises with the piston's position over the whole stroke")
    level, (before, after) = terms.dry_friction(model_bench), null_shifts(model_bench.effects)
    bristles = any(effect["id"] == "friction_presliding" for effect in model_bench.effects)
    (lag, inertia), (gain, bias) = terms.load_cell_coefficients(model_bench), terms.sensor_calibration(model_bench)
    area, stiffness_a = float(numbers["piston_area"]), hydraulics.stiffnesses(numbers, float(rest[2]))[0]
    half_supply = sqrt(0.5 * float(numbers["supply_pressure"]))
    delay = catalogue.total_delay(model_bench.effects)

    # coordinates that the bench file adds to the eight: of lagging pressure sensors, then of currents in the dead time
    sensors = terms.lagging_sensors(model_bench, states, linear_states)
    on_their_way = ceil(delay / SAMPLE_PERIOD - DEAD_TIME_TOLERANCE)
    lagging, observer = np.zeros(2, LOOP_DTYPE["lagging"].base), np.zeros((3, 6))
    for i, one in enumerate(sensors):
        lagging[i] = one.signal_index, one.rate_index, one.chamber, one.delay
    if count := len(sensors):
        observer[: count + 1, : 3 * count] = terms.pressure_observer(linear, sensors, size)
    scale = coordinate_scales(box_bench)
    pressure, currents = float(scale[Q_HYDRAULIC]) / model_bench.piston_area, TEXTBOOK_STATE_COUNT + len(linear_states)
    kept = [index for one in sensors for index in (one.linear_signal_index, one.linear_rate_index)]
    kept += range(currents, currents + on_their_way)
    added = [unit for one in sensors for unit in (pressure, one.omega * pressure)]
    added += [float(scale[Q_SPOOL])] * on_their_way

    values: dict[str, Any] = {
        "sample": whole.address_of("bench_sample"), "jacobian": linear.address_of("bench_jacobian"),
        "coordinates": len(scale) + len(added), "lagging": lagging, "lagging_count": count, "observer": observer,
        "force_shown": terms.state_index(states, terms.FORCE_CELL_LAG, "signal"),
        "delay": delay, "past": past, "at_valve": floor(delay / SAMPLE_PERIOD + DEAD_TIME_TOLERANCE),
        "on_their_way": on_their_way, "spool_age": terms.lag_delay(terms.find_parameters(model_bench, terms.VALVE_LAG)),
        "before": before, "after": after,
        "points": len(forces), "first": positions[0], "step": positions[1] - positions[0],
        "level": level, "holds": level > 0.0 and not bristles,
        "creep": 0.025 * size.length,  # m/s, below which the velocity's sign is noise
        "lag": lag, "inertia": inertia, "gain": gain, "bias": bias,
        "allowed": size.force * FORCE_ALLOWANCES + size.pressure * terms.PRESSURE_UNCERTAINTY * PRESSURE_ALLOWANCES,
        "area": area, "ratio": float(numbers["area_ratio"]), "mass": float(numbers["moving_mass"]),
        "dead_a": float(numbers["dead_volume_a"]), "dead_b": float(numbers["dead_volume_b"]),
        "stroke": float(numbers["stroke"]),
        "bend_max": size.force * (2000.0 / 3.0),  # of f_r'', about that of a sine of this force at 4 Hz
        # g is zero where both chambers are at their limits
        "least_gain": 0.1 * area * stiffness_a * float(numbers["valve_gain"]) * half_supply,
        "least_opening": 0.1 * float(numbers["valve_current_max"]),
        "gain_floor": float(BoxConfig().constants(box_bench)["gain_floor"][0]),
        "velocity_memory": float(Sensors().constants()[0]["velocity_memory"]),
        "bench": believed_numbers(box_bench),
    }  # fmt: skip
    for name, model, indices in (("whole", whole, states), ("linear", linear, linear_states)):
        cell, cell_rate = terms.load_cell_indices(model.bench, indices)
        values |= {
            f"{name}.rates": model.address_of("bench_rates"), f"{name}.states": len(model.states),
            f"{name}.spool": terms.state_index(indices, terms.VALVE_LAG, "spool"),
            f"{name}.spool_rate": terms.state_index(indices, terms.VALVE_LAG, "rate"),
            f"{name}.cell": cell, f"{name}.cell_rate": cell_rate,
        }  # fmt: skip
    arrays: dict[str, npt.NDArray[Any]] = {
        "whole.k": k, "linear.k": linear.begin(linear.values)[0], "sample_k": whole.begin(carried)[0],
        "from_whole": np.array(from_whole, np.int32), "rest": rest, "forces": forces,
        "scale": np.append(scale, added), "kept": np.array(kept, np.int32),
    }  # fmt: skip
    return Loop(model_bench, box_bench, values, arrays, make_record(LOOP_DTYPE, values, arrays))


def check_representable(bench: Bench) -> None:
    """Raise ValueError if the certificate cannot represent one of a bench's effects or closures."""
    static = [one for one in bench.closures if not has_hidden_states(one)]
    loads: list[Mapping[str, Any]] = [{"id": "closure", **one} for one in static if one["equation"] == "load"]
    refused: dict[str, list[Mapping[str, Any]]] = {
        "what closures remember": [one for one in bench.closures if has_hidden_states(one)],
        "sensors that are not straight": [one for one in static if one["equation"] == "sensor"],
        "a mass that the load drags along": [one for one in loads if "acceleration" in signals_of(one)],
        "a load that follows the velocity": [one for one in loads if terms.depends_on_velocity(bench, one)],
    }
    for what, closures in refused.items():
        if closures:
            forms = ", ".join(str(one["form"]) for one in closures)
            raise ValueError(
                f"the certificate has no place for {what}: take {forms} out of the bench file, where small"
            )
    for what, label in SINGLE_LAG_EFFECTS.items():
        if sum(catalogue.label(effect).startswith(label) for effect in bench.effects) > 1:
            raise ValueError(f"the filter's certificate has a place for one lag of {what}, the bench file has more")


def closing_current(loop: Loop) -> float:
    """Return the current [A] that closes the valve, from the bench file's null shifts."""
    return -float(loop["before"] + loop["after"])


def coordinate_names(loop: Loop) -> tuple[str, ...]:
    """Return the names of the coordinates: `LOOP_FIELDS`, then those of the bench file's lags and dead time."""
    chambers = loop["lagging"]["chamber"][: loop["lagging_count"]]
    shown = [f"p_{'ab'[chamber]}_shown{ending}" for chamber in chambers for ending in ("", "_rate")]
    return (*LOOP_FIELDS, *shown, *(f"current_{i + 1}" for i in range(loop["on_their_way"])))


def rest_measurement(loop: Loop) -> FloatArray:
    """Return the measurement x, shape (8,), of the bench at rest, with gains and biases of its sensors."""
    y, x = loop.arrays["rest"], np.zeros(STATE_SIZE)
    force = loop["area"] * (y[0] - loop["ratio"] * y[1])
    true = np.array([force, y[loop["whole.cell"]], *y[:3]])
    x[[HYDRAULIC_FORCE, LOAD_FORCE, PRESSURE_A, PRESSURE_B, POSITION]] = loop["gain"] * true + loop["bias"]
    return x


def make_samples(x: FloatArray, **signals: Any) -> RecordArray:
    """Return records of `SAMPLE_DTYPE`, shape (n,), armed, from measurements x, shape (n, 8).

    `signals`: fields of the record, 0 otherwise; f_c and f_c' are f_r and f_r', C_1 and C_2 are 1.
    """
    samples = np.zeros(len(x), SAMPLE_DTYPE)
    samples["x"], samples["c_1"], samples["c_2"], samples["armed"] = x, 1.0, 1.0, True
    for name, values in signals.items():
        samples[name] = values
    samples["followed"], samples["followed_rate"] = samples["reference"], samples["reference_rate"]
    return samples


def recorded_samples(states: StateArray, velocity_compensation: float = 1.0) -> RecordArray:
    """Return records of `SAMPLE_DTYPE`, shape (n,), of a recorded run under a law with this C_1, C_2 = 1, f_c = f_r."""
    names = ("nominal_valve_current", "valve_current", "reference_force", "reference_force_rate", "proportional_gain")
    fields = ("nominal", "current", "reference", "reference_rate", "k_p")
    signals = {field: states[name] for field, name in zip(fields, names, strict=True)}
    return make_samples(to_matrix(states), **signals, c_1=velocity_compensation)


def without_disturbances(bench: Bench) -> Bench:
    """Return the bench without `DISTURBANCE_EFFECTS` and motion closures that depend on the direction of motion."""
    return replace(
        bench,
        effects=tuple(effect for effect in bench.effects if effect["id"] not in DISTURBANCE_EFFECTS),
        closures=tuple(one for one in bench.closures if one["equation"] != "motion" or not depends_on_direction(one)),
    )


def without_overlap(bench: Bench) -> Bench | None:
    """Return the bench without its valve's overlap; None if it has none."""
    kept = tuple(effect for effect in bench.effects if effect["id"] != OVERLAP_EFFECT)
    return replace(bench, effects=kept) if len(kept) < len(bench.effects) else None
