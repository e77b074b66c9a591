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
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_core.size import Size
from hydro_filter.model.coordinates import LOOP_FIELDS, Q_SPOOL_RATE, least_gain, loop_scale
from hydro_filter.model.overlap import Overlap
from hydro_filter.model.parts import MEMORY_DTYPE, Loop, ModelParts, Step
from hydro_filter.model.sample import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES
from hydro_filter.model.terms import (
    UNCERTAINTY,
    added_coordinates,
    cell_dynamics,
    cell_states,
    current_at_valve,
    currents_on_their_way,
    follows_velocity,
    hidden_state_numbers,
    load_curve,
    null_shifts,
    pressure_observer,
    sensor_scales,
    state_number,
    valve_age,
)
from hydro_sim.box.box import BoxConfig
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.grammar import remembers, reverses, uses
from hydro_sim.model.sensors import RAW_FIELDS, Sensors

DISTURBANCES = ("friction_coulomb", "friction_stribeck", "friction_presliding", "valve_deadband", "backlash")
"""Effects that the linearized loop leaves out."""

OVERLAP = "valve_deadband"
"""Of these, the one within which no current moves anything: B = 0."""

BEND_MAX = 2000.0 / 3.0
"""1/s^2, limit of f_r'' over the bench's force: that at 4 Hz."""
CREEP = 0.025
"""1/s, `ModelParts.creep` over the stroke."""
FORCES_ALLOWED, PRESSURES_ALLOWED = np.array([0.025, 0.05, 0.04, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
"""`ModelParts.allowed` over the bench's force: 2.5 %; dry friction; a cell's drift; of pressures in `UNCERTAINTY`."""

CARRIED = 1e6
"""Mass within a sample over the bench's: hidden states follow the measured velocity, not what bristles make of it
within the sample, whose bend is unknown at first."""

SUBSTEPS = 4
"""Integration steps per sample: 250 us, a 44th of a period of the 90 Hz mass-on-oil mode."""

ONE_LAG = {
    "the valve": "valve_lag",
    "the load cell": "sensor_lag sensor=load_force",
    "the load cell of f_h": "sensor_lag sensor=hydraulic_force",
    "the pressure sensor of a": "sensor_lag sensor=pressure_a",
    "the pressure sensor of b": "sensor_lag sensor=pressure_b",
}
"""Labels of effects of which a bench has one at most."""


def loop_of(truth: Bench, believed: Bench) -> Loop:
    """Return the loop of the bench file `truth` under a box configured for `believed`.

    Raises ValueError: the certificate's coordinates cannot represent this bench; the message is one sentence.
    """
    refuse(truth)
    floor, scale = float(BoxConfig().constants(believed)["gain_floor"][0]), loop_scale(believed)
    model, added = parts(truth, scale, believed.size)
    return Loop(model, believed.constants(), floor, believed.valve_current_max, np.append(scale, added))


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


def step_of(loop: Loop) -> Step:
    """Allocate the workspace of one caller."""
    whole, n, width = len(loop.model.rest), len(loop.model.from_whole), len(loop.scale)
    shapes = (
        (width, width), width, width, STATES, whole, n, n, len(RAW_FIELDS),
        (n, n + 1), (len(RAW_FIELDS), n + 1), (n + 1, width), (n, width),
    )  # fmt: skip
    return Step(*(np.zeros(shape) for shape in shapes))


def memories(count: int = 1) -> npt.NDArray[np.void]:
    """Return new memories of `count` benches, shape (count,)."""
    return np.zeros(count, MEMORY_DTYPE)


def closing_current(loop: Loop) -> float:
    """Return the current [A] that closes the valve, from the bench file's null shifts."""
    return -(loop.model.before + loop.model.after)


def coordinates_of(loop: Loop) -> tuple[str, ...]:
    """Return the names of the certificate's coordinates: `LOOP_FIELDS`, and those that the bench file adds."""
    shown = [f"p_{'ab'[chamber]}_shown{ending}" for chamber in loop.model.lagging[:, 2] for ending in ("", "_rate")]
    return (*LOOP_FIELDS, *shown, *(f"current_{i + 1}" for i in range(loop.model.on_their_way)))


def driven_coordinate(loop: Loop) -> int:
    """Return the coordinate whose entry of G follows g everywhere: the spool's rate, or the newest current."""
    return len(loop.scale) - loop.model.on_their_way if loop.model.on_their_way else Q_SPOOL_RATE


def rest_measurement(model: ModelParts) -> FloatArray:
    """Sensor readings of the bench at rest, with gains and biases: x, shape (8,)."""
    y, x = model.rest, np.zeros(STATES)
    force = model.area * (y[0] - model.ratio * y[1])
    true = np.array([force, y[model.cell], *y[:3]])
    x[[HYDRAULIC_FORCE, LOAD_FORCE, PRESSURE_A, PRESSURE_B, POSITION]] = model.gain * true + model.bias
    return x


def parts(truth: Bench, scale: FloatArray, size: Size) -> tuple[ModelParts, FloatArray]:
    """Compute the `ModelParts` of a bench file, and the scales of its added coordinates; `scale`: of the eight."""
    loop_bench = without_disturbances(truth)
    whole, loop = BenchModel(truth, substeps=SUBSTEPS), BenchModel(loop_bench, substeps=SUBSTEPS)
    k, rest, _ = whole.begin(whole.values)
    carried = whole.values * [CARRIED if one.name == "moving_mass" else 1.0 for one in whole.parameters]
    loop_k, loop_rest, _ = loop.begin(loop.values)
    places, loop_places = hidden_state_numbers(truth), hidden_state_numbers(loop_bench)
    numbers = truth.constants()[0]
    chosen = [effect for effect in truth.terms if effect["id"] not in DISTURBANCES]
    past = whole.structure.past
    from_whole = [*range(TEXTBOOK), *(places[name] for name in loop_places), *range(len(rest) - past, len(rest))]
    before, after = null_shifts(truth)
    lag, inertia = cell_dynamics(truth)
    added = added_coordinates(truth, places, loop_places, scale)
    sensors = np.column_stack((added.kept[: 2 * len(added.lagging)].reshape(-1, 2), added.lagging[:, 2:]))
    direct = np.array([float(chamber not in added.lagging[:, 2]) for chamber in range(2)])
    positions: FloatArray = np.asarray(np.linspace(-0.05, 1.05, 1101) * float(numbers["stroke"]), np.float64)
    forces = load_curve(numbers, chosen, positions)
    if not (np.diff(forces) > 0.0).all():
        raise ValueError("the filter needs a load that rises with the piston's position over the whole stroke")
    dry = [
        effect["parameters"] for effect in truth.effects if effect["id"] in ("friction_coulomb", "friction_stribeck")
    ]
    level = sum(max(value for name, value in each.items() if "force" in name) for each in dry)
    bristles = any(effect["id"] == "friction_presliding" for effect in truth.effects)
    gain, bias = sensor_scales(truth)
    record = Sensors().constants()[0]
    area, ratio = float(numbers["piston_area"]), float(numbers["area_ratio"])
    stiffness_a = hydraulics.stiffnesses(numbers, float(rest[2]))[0]
    least = least_gain(area, stiffness_a, float(numbers["valve_gain"]), float(numbers["supply_pressure"]))
    cell, loop_cell = cell_states(truth, places), cell_states(loop_bench, loop_places)
    model = ModelParts(
        sample_at=whole.address_of("bench_sample"), rates_at=whole.address_of("bench_rates"), k=k,
        sample_k=whole.begin(carried)[0],
        loop_rates_at=loop.address_of("bench_rates"), loop_jacobian_at=loop.address_of("bench_jacobian"),
        loop_k=loop_k, from_whole=np.array(from_whole, np.int64), rest=rest,
        spool=state_number(places, "valve_lag", "spool"), spool_rate=state_number(places, "valve_lag", "rate"),
        loop_spool=state_number(loop_places, "valve_lag", "spool"),
        loop_spool_rate=state_number(loop_places, "valve_lag", "rate"), before=before, after=after,
        cell=cell[0], cell_rate=cell[1], loop_cell=loop_cell[0], loop_cell_rate=loop_cell[1],
        lagging=added.lagging, observer=pressure_observer(loop, sensors, size), sensor_ages=added.ages, direct=direct,
        kept=added.kept, on_their_way=currents_on_their_way(truth), past=past, at_valve=current_at_valve(truth),
        delay=catalogue.delay(truth.effects), spool_age=valve_age(truth),
        force_shown=state_number(places, "sensor_lag sensor=hydraulic_force", "signal"),
        lag=lag, inertia=inertia, gain=gain, bias=bias,
        area=area, ratio=ratio, mass=float(numbers["moving_mass"]), positions=positions, forces=forces,
        holds=level > 0.0 and not bristles, level=level, least_gain=least,
        least_opening=0.1 * float(numbers["valve_current_max"]),
        bend_max=size.force * BEND_MAX, creep=size.length * CREEP,
        allowed=size.force * FORCES_ALLOWED + size.pressure * UNCERTAINTY * PRESSURES_ALLOWED,
        memories=np.array([record["force_memory"], record["velocity_memory"]]),
        slopes=TEXTBOOK + max(len(rest), len(loop_rest)),
    )  # fmt: skip
    return model, added.scale


def without_disturbances(truth: Bench) -> Bench:
    """Return the bench without the effects and closures that the linearization leaves out."""
    return replace(
        truth,
        effects=tuple(effect for effect in truth.effects if effect["id"] not in DISTURBANCES),
        closures=tuple(one for one in truth.closures if one["equation"] != "motion" or not reverses(one)),
    )


def without_overlap(truth: Bench) -> Bench | None:
    """Return the bench without its valve's overlap; None if it has none."""
    kept = tuple(effect for effect in truth.effects if effect["id"] != OVERLAP)
    return replace(truth, effects=kept) if len(kept) < len(truth.effects) else None


def overlap_of(truth: Bench) -> Overlap:
    """Return the overlap of a bench's valve: of several, the sum; of a soft one, its half width."""
    closing, back, out = -sum(null_shifts(truth)), 0.0, 0.0
    for effect in truth.effects:
        if effect["id"] == OVERLAP:
            widths = effect["parameters"]
            out += float(widths["half_width"])
            back += float(widths.get("half_width_negative", widths["half_width"]))
    return Overlap(closing, back, out)
