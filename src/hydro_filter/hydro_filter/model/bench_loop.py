# SPDX-License-Identifier: Apache-2.0
"""The loop of a bench file: what `bench_kernels` reads of a `BenchModel`, and which benches have a certificate.

Two models stand behind it, both compiled from the bench file::

    whole   every effect: what is predicted, what hidden states do, what the monitor compares with
    loop    without `DISTURBANCES`: what is linearized, by its exact Jacobian

Dry friction, overlap and gaps are bounded disturbances to the certificate, as dry friction is to the structured model:
inside of them nothing moves, and a derivative there says nothing of the loop.

The certificate has eight coordinates. What has no place among them is refused: dead times, a second lag of the valve, a
second lag on the load's force. Other hidden states (bristles, a drooping supply) are
held fixed in derivatives by x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf, pi, sqrt
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_filter.model.loop_model import LOOP, loop_scale
from hydro_filter.model.state import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES
from hydro_sim.box.box import BoxConfig
from hydro_sim.model import rates
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK, BenchModel, Part, is_compiled, structure_of
from hydro_sim.model.effects import catalogue
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.equations import LOAD_CELL_DAMPING
from hydro_sim.model.grammar import remembers
from hydro_sim.model.plant import STATES_MAX
from hydro_sim.model.sensors import RAW_FIELDS, Sensors

DISTURBANCES = ("friction_coulomb", "friction_stribeck", "friction_presliding", "valve_deadband", "backlash")
"""Effects that the linearized loop leaves out."""

SUBSTEPS = 4
"""Integration steps per sample: 250 us, a 44th of a period of the 90 Hz mass-on-oil mode."""

NONE = -1
"""In the place of a state's number: the bench has no such state."""

BENCH_MEMORY_DTYPE = np.dtype(
    [("hidden", np.float64, (STATES_MAX + 2,)), ("reference_rate", np.float64), ("current", np.float64),
     ("running", np.bool_)], align=True,
)  # fmt: skip
"""What is remembered of one bench: the whole model's states, behind them the valve's opening [A] and its rate [A/s];
the last f_r' [N/s]; the current [A] of the last sample; whether it ran."""


class BenchParts(NamedTuple):
    """What compiled code reads of the two models; `bench_loop` makes it."""

    sample_at: int
    rates_at: int
    k: FloatArray
    loop_rates_at: int
    loop_jacobian_at: int
    loop_k: FloatArray
    from_whole: npt.NDArray[np.int64]
    """Of each state of the loop's model: its number in the whole model."""
    rest: FloatArray
    """The whole model's still bench."""
    spool: int
    """Of the whole model; `NONE`: the spool is where the current puts it."""
    spool_rate: int
    loop_spool: int
    loop_spool_rate: int
    before: float
    """A, null shift between current and spool."""
    after: float
    """A, null shift behind the spool's lag."""
    cell: int
    """What the load cell shows, and its rate, of the whole model."""
    cell_rate: int
    loop_cell: int
    loop_cell_rate: int
    lagging: npt.NDArray[np.int64]
    """Rows: a lagging pressure sensor's signal, the pressure."""
    lag: float
    """s, s^2: of the load cell, 2 d/w and 1/w^2."""
    inertia: float
    gain: FloatArray
    """Shape (5,): of the readings."""
    bias: FloatArray
    area: float
    ratio: float
    mass: float
    positions: FloatArray
    """m, and the load there [N]: rises."""
    forces: FloatArray
    holds: bool
    """Whether dry friction can hold the piston."""
    least_gain: float
    """N/s/A: a chamber at its limit has no gain."""
    least_opening: float
    """A, at which the gain is taken where the valve is closed."""
    memories: FloatArray
    """Of the box's differentiators: force rates, velocity."""
    slopes: int
    """Rates that both models have at most."""


class BenchLoop(NamedTuple):
    """As `loop_model.LoopModel`, of a bench file."""

    model: BenchParts
    bench: npt.NDArray[np.void]
    """What the box's force law believes, shape (1,)."""
    gain_floor: float
    current_max: float
    scale: FloatArray


class BenchStep(NamedTuple):
    """As `loop_model.LoopStep`, of a bench file."""

    transition: FloatArray
    push: FloatArray
    feedback: FloatArray
    state_rate: FloatArray
    law: FloatArray
    whole: FloatArray
    before: FloatArray
    after: FloatArray
    reading: FloatArray
    by_state: FloatArray
    by_reading: FloatArray
    embedded: FloatArray
    moved: FloatArray


def bench_loop(truth: Bench, believed: Bench, box: BoxConfig | None = None) -> BenchLoop:
    """The loop of the bench file `truth` under a box that believes `believed`.

    Raises
    ------
    ValueError
        In one sentence: the certificate's eight coordinates have no place for what this bench does.
    """
    _refuse(truth)
    floor = float((box or BoxConfig()).constants(believed)["gain_floor"][0])
    return BenchLoop(parts(truth), believed.constants(), floor, believed.valve_current_max, loop_scale(believed))


def bench_step(loop: BenchLoop) -> BenchStep:
    """New space for one caller."""
    whole, n = len(loop.model.rest), len(loop.model.from_whole)
    shapes = (
        (LOOP, LOOP), LOOP, LOOP, STATES, STATES, whole, n, n, len(RAW_FIELDS),
        (n, n + 1), (len(RAW_FIELDS), n + 1), (n + 1, LOOP), (n, LOOP),
    )  # fmt: skip
    return BenchStep(*(np.zeros(shape) for shape in shapes))


def still(model: BenchParts) -> FloatArray:
    """What the sensors show of the still bench, gains and biases with it: x, shape (8,)."""
    y, x = model.rest, np.zeros(STATES)
    force = model.area * (y[0] - model.ratio * y[1])
    true = np.array([force, y[model.cell], *y[:3]])
    x[[HYDRAULIC_FORCE, LOAD_FORCE, PRESSURE_A, PRESSURE_B, POSITION]] = model.gain * true + model.bias
    return x


def parts(truth: Bench) -> BenchParts:
    """See `BenchParts`."""
    loop_bench = without_disturbances(truth)
    whole, loop = BenchModel(truth, substeps=SUBSTEPS), BenchModel(loop_bench, substeps=SUBSTEPS)
    k, rest, _ = whole.begin(whole.values)
    loop_k, loop_rest, _ = loop.begin(loop.values)
    places, loop_places = _places(truth), _places(loop_bench)
    numbers = truth.constants()[0]
    chosen = [effect for effect in truth.terms if effect["id"] not in DISTURBANCES]
    from_whole = list(range(TEXTBOOK))
    for name in loop_places:
        from_whole.append(places[name])
    lag_name = _first(places, "valve_lag", "spool"), _first(places, "valve_lag", "rate")
    cell_name = _first(places, "sensor_lag sensor=load_force", "signal")
    before, after = _shifts(truth)
    lag, inertia = _cell(truth)
    amplified = cell_name is not None or float(numbers["load_cell_omega"]) > 0.0
    lagging = [
        (place, TEXTBOOK_PRESSURES[label])
        for (label, _, state), place in places.items() if label in TEXTBOOK_PRESSURES and state == "signal"
    ]  # fmt: skip
    positions: FloatArray = np.asarray(np.linspace(-0.05, 1.05, 1101) * float(numbers["stroke"]), np.float64)
    forces = _load(numbers, chosen, positions)
    if not (np.diff(forces) > 0.0).all():
        raise ValueError("the filter needs a load that rises with the piston's position over the whole stroke")
    dry = any(effect["id"].startswith(("friction_coulomb", "friction_stribeck")) for effect in truth.effects)
    bristles = any(effect["id"] == "friction_presliding" for effect in truth.effects)
    gain, bias = _shown(truth)
    record = Sensors().constants()[0]
    area, ratio = float(numbers["piston_area"]), float(numbers["area_ratio"])
    volume_a = float(numbers["dead_volume_a"]) + area * float(rest[2])
    stiffness = float(numbers["bulk_modulus"]) * area / volume_a
    least = 0.1 * stiffness * float(numbers["valve_gain"]) * sqrt(0.5 * float(numbers["supply_pressure"]))
    signal, rate = ("signal", "rate") if cell_name is not None else ("", "")
    load = "sensor_lag sensor=load_force"
    return BenchParts(
        sample_at=whole.address, rates_at=whole.address_of("bench_rates"), k=k,
        loop_rates_at=loop.address_of("bench_rates"), loop_jacobian_at=loop.address_of("bench_jacobian"),
        loop_k=loop_k, from_whole=np.array(from_whole, np.int64), rest=rest,
        spool=_place(places, lag_name[0]), spool_rate=_place(places, lag_name[1]),
        loop_spool=_place(loop_places, _first(loop_places, "valve_lag", "spool")),
        loop_spool_rate=_place(loop_places, _first(loop_places, "valve_lag", "rate")),
        before=before, after=after,
        cell=_place(places, _first(places, load, signal)) if signal else 4,
        cell_rate=_place(places, _first(places, load, rate)) if rate else 5 if amplified else NONE,
        loop_cell=_place(loop_places, _first(loop_places, load, signal)) if signal else 4,
        loop_cell_rate=_place(loop_places, _first(loop_places, load, rate)) if rate else 5 if amplified else NONE,
        lagging=np.array(lagging, np.int64).reshape(-1, 2), lag=lag, inertia=inertia, gain=gain, bias=bias,
        area=area, ratio=ratio, mass=float(numbers["moving_mass"]), positions=positions, forces=forces,
        holds=dry and not bristles, least_gain=least, least_opening=0.1 * float(numbers["valve_current_max"]),
        memories=np.array([record["force_memory"], record["velocity_memory"]]),
        slopes=TEXTBOOK + max(len(rest), len(loop_rest)),
    )  # fmt: skip


def without_disturbances(truth: Bench) -> Bench:
    """The bench that is linearized."""
    return replace(truth, effects=tuple(effect for effect in truth.effects if effect["id"] not in DISTURBANCES))


def uncompiled(truth: Bench) -> str:
    """Effects of the model that still has to be compiled for this loop, for people; empty where none has to be."""
    parts_needed: tuple[tuple[Bench, Part], ...] = (
        (truth, ""), (without_disturbances(truth), ""), (without_disturbances(truth), "derivatives"),
    )  # fmt: skip
    if all(is_compiled(structure_of(bench, SUBSTEPS), part) for bench, part in parts_needed):
        return ""
    return ", ".join(map(catalogue.label, truth.terms)) or "no effects"


TEXTBOOK_PRESSURES = {"sensor_lag sensor=pressure_a": 0, "sensor_lag sensor=pressure_b": 1}
Name = tuple[str, int, str]
"""Of a hidden state: its effect's label, the how many-th of that label, the state."""


def _refuse(truth: Bench) -> None:
    if catalogue.delay(truth.effects) > 0.0:
        raise ValueError(
            "the filter's certificate has no place for a dead time: take transport_delay out of the bench file, where "
            "it is small beside the valve's lag"
        )
    remembering = [one["form"] for one in truth.closures if remembers(one)]
    if remembering:
        raise ValueError(
            f"the filter's certificate has no place for what closures remember: take {', '.join(remembering)} out of "
            "the bench file, where it is small"
        )
    lags = sum(effect["id"] == "valve_lag" for effect in truth.effects)
    cells = sum(catalogue.label(effect) == "sensor_lag sensor=load_force" for effect in truth.effects)
    if lags > 1 or cells > 1:
        what = "the valve" if lags > 1 else "the load cell"
        raise ValueError(f"the filter's certificate has a place for one lag of {what}, the bench file has more")


def _places(bench: Bench) -> dict[Name, int]:
    """Numbers of a bench's hidden states in its model."""
    seen: dict[str, int] = {}
    places: dict[Name, int] = {}
    for effect in bench.terms:
        label = catalogue.label(effect)
        seen[label] = seen.get(label, -1) + 1
        for state in catalogue.kind_of(effect)[0].effect.states:
            places[label, seen[label], state.name] = TEXTBOOK + len(places)
    return places


def _first(places: Mapping[Name, int], label: str, state: str) -> Name | None:
    return next((name for name in places if name[0].startswith(label) and name[2] == state), None)


def _place(places: Mapping[Name, int], name: Name | None) -> int:
    return NONE if name is None else places[name]


def _made(numbers: Any, effect: Mapping[str, Any]) -> Effect:
    """An effect with its numbers, for terms that need no state."""
    kind, values = catalogue.kind_of(effect)
    made = kind.make()
    made.at = SimpleNamespace(numbers=numbers)
    for parameter, value in zip(kind.parameters, values, strict=True):
        setattr(made, parameter.name, value)
    return made


def _load(record: Any, effects: list[Mapping[str, Any]], positions: FloatArray) -> FloatArray:
    """f_l [N] at positions [m], gaps left out."""
    numbers = SimpleNamespace(**{name: float(record[name]) for name in record.dtype.names})
    force = rates.load(numbers, [_made(numbers, effect) for effect in effects], positions)
    return np.asarray(force, np.float64)


def _shown(truth: Bench) -> tuple[FloatArray, FloatArray]:
    """Gain and bias of the five readings."""
    made = [_made(None, effect) for effect in truth.effects]
    ends = np.array([[0.0] * len(RAW_FIELDS), [1.0] * len(RAW_FIELDS)])
    for effect in made:
        ends = np.array([[effect.show(name, z) for name, z in zip(RAW_FIELDS, row, strict=True)] for row in ends])
    return ends[1] - ends[0], ends[0]


def _shifts(truth: Bench) -> tuple[float, float]:
    """Null shifts [A] before and behind the valve's lag, in the order of the bench file."""
    shifts, behind = [0.0, 0.0], False
    for effect in truth.effects:
        behind = behind or effect["id"] == "valve_lag"
        if effect["id"] == "valve_offset":
            shifts[int(behind)] += catalogue.kind_of(effect)[1][0]
    return shifts[0], shifts[1]


def _cell(truth: Bench) -> tuple[float, float]:
    """2 d/w [s] and 1/w^2 [s^2] of what shows f_l."""
    for effect in truth.effects:
        if catalogue.label(effect) == "sensor_lag sensor=load_force":
            bandwidth, damping = catalogue.kind_of(effect)[1]
            return 2.0 * damping / (2.0 * pi * bandwidth), (2.0 * pi * bandwidth) ** -2
    omega = float(truth.constants()["load_cell_omega"][0]) or inf
    return 2.0 * LOAD_CELL_DAMPING / omega, 1.0 / omega**2
