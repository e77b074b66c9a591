# SPDX-License-Identifier: Apache-2.0
"""Vectorised environment: many benches, each with box and plant, advanced ten samples at a time by one compiled loop.

::

    axes        [bench]                             every record array below has one row per bench
    sample s    plant holds u_s -> x_{s+1}          box receives gains, ticks -> u_{s+1}, BenchState_{s+1}
    step        ten such samples, from one policy step (sequence number divisible by ten) to the next

Results are bit-identical to those of `simulation.offline.simulate` and of the nodes: box and plants are the same
compiled functions. Gains act `gain_delay` samples after the step that chose them (1 to 10; 1: the fastest possible
graph), and the valve follows its current `dead_time` samples late (0: the box's own loop).

Plants of one kind are rows of arrays: a NamedTuple with two compiled functions, `advance` and `measurement`, dispatched
on its type (numba's overloading). They are created and reset as usual; here only their states are stacked. The
contraction filter, if there is one, computes the next sample's correction from each sample, as in the graph.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.core import types
from numba.extending import overload

from hydro_core.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_DTYPE,
    Command,
    Flag,
    FloatArray,
    Law,
    ReferenceSignal,
    StateArray,
)
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.model import records as filter_records
from hydro_policy.compensation.estimator import VALIDITY_MASK
from hydro_policy.compensation.residual import AdaptedLaw
from hydro_policy.envs import FilterName
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig, fill_command
from hydro_sim.box.firmware import (
    SHAPING_COEFFICIENT_COUNT,
    VALVE_GAIN_SCALE_INDEX,
    VELOCITY_COMPENSATION_INDEX,
    signal_record,
)
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model import plant as plants_of
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant

Records = npt.NDArray[np.void]


class AnalyticArrays(NamedTuple):
    """Stacked arrays of `AnalyticPlant`s, one row per bench."""

    constants: Records
    sensors: Records
    state: Records


def advance(plants: Any, i: int, noise: FloatArray, current: float) -> None:
    """Advance row i by one sample of 1 ms, in place; for compiled code."""
    raise NotImplementedError("compiled code only")


def measurement(plants: Any, i: int) -> FloatArray:
    """Return the measurement x, shape (8,), of row i; for compiled code."""
    raise NotImplementedError("compiled code only")


@overload(advance)
def _advance(plants, i, noise, current):
    if getattr(plants, "instance_class", None) is AnalyticArrays:

        def analytic(plants, i, noise, current):
            one = slice(i, i + 1)
            plants_of.advance(plants.constants[one], plants.sensors[one], plants.state[one], noise, current)

        return analytic
    return None


@overload(measurement)
def _measurement(plants, i):
    if getattr(plants, "instance_class", None) is AnalyticArrays:
        return lambda plants, i: plants.state[i].x
    if isinstance(plants, types.NamedTuple):
        return lambda plants, i: plants.x[i]
    return None


def _copy_analytic(arrays: AnalyticArrays, index: int, plant: AnalyticPlant) -> None:
    for name in AnalyticArrays._fields:
        getattr(arrays, name)[index] = getattr(plant, name)[0]


PLANT_TYPES: dict[Any, tuple[Callable[[Any], Any], Callable[[Any, int, Any], None]]] = {
    AnalyticPlant: (
        lambda plants: AnalyticArrays(
            *(np.concatenate([getattr(p, name) for p in plants]) for name in AnalyticArrays._fields)
        ),
        _copy_analytic,
    )
}
"""Functions of each plant type: one stacks plants into arrays, one copies a plant's constants and state into a row. A
benchmark may add a type."""


_ARMED_BIT = np.uint32(Flag.ARMED)


class VectorFilter(NamedTuple):
    """Compiled filter of vectorised benches: decision function, parameters, states, and input and output buffers.

    If no filter runs, `fresh` is False, commands are sent as without a fresh filter, and the box sets FILTER_STALE.
    """

    fresh: bool  # whether a filter runs
    decide: int  # address of the compiled decision function
    parameters: Records
    states: Records  # one row per bench
    sample: Records  # buffers for the present bench's sample and decision, shape (1,) each
    decision: Records


def vector_filter(kind: FilterName, box_bench: Bench, count: int) -> VectorFilter:
    """Return a filter of this kind for `count` benches, designed for the bench `box_bench`."""
    parameters = default_filter(box_bench).record if kind == "learned" else np.zeros(1, filter_records.FILTER_DTYPE)
    sample, decision = np.zeros(1, filter_records.SAMPLE_DTYPE), np.zeros(1, filter_records.DECISION_DTYPE)
    states = filter_records.new_memories(count)
    return VectorFilter(kind == "learned", filter_records.decide_address(), parameters, states, sample, decision)


DEAD_TIME_MAX = 8  # maximum delay of a command, samples

LINK_DTYPE = np.dtype([("gain_delay", np.int64), ("dead_time", np.int64), ("held", np.float64, (DEAD_TIME_MAX + 1,))])
"""Transport delays between policy, box and valve [samples], and the currents in transit [A], newest first."""


class VectorBench:
    """Vectorised benches in one compiled loop (see the module's docstring).

    `benches`: bench assumed by each box. `plants`: plant behind each box, all of one kind. `config`: settings of the
    boxes. `filters`: filter between policy and box; None: no filter.
    """

    def __init__(
        self,
        benches: Sequence[Bench],
        plants: Sequence[Plant],
        config: BoxConfig | None = None,
        filters: VectorFilter | None = None,
    ) -> None:
        self.config = config or BoxConfig()
        self.filters = filters or vector_filter("none", benches[0], len(plants))
        make, self._copy = PLANT_TYPES[type(plants[0])]
        self.plants, self.rows, count = list(plants), make(plants), len(plants)
        for index, plant in enumerate(plants):
            self._copy(self.rows, index, plant)
        self.settings = np.concatenate([self.config.constants(bench) for bench in benches])
        self.boxes = np.zeros(count, firmware.DOUBLE_STRUCTURES.box)
        self.commands = np.zeros(count, firmware.DOUBLE_STRUCTURES.command)
        self.links = np.zeros(count, LINK_DTYPE)
        self.links["gain_delay"] = 1
        self.samples: StateArray = np.zeros((count, SAMPLES_PER_STEP), STATE_DTYPE)
        """Samples of the last step, shape (benches, 10); the policy acts upon the last column."""
        self.compensated = np.zeros((count, SAMPLES_PER_STEP))  # compensated references f_c [N] of the same samples

    def __len__(self) -> int:
        return len(self.boxes)

    def replace(self, index: int, bench: Bench, plant: Plant, gain_delay: int = 1, dead_time: int = 0) -> None:
        """Replace the bench at this index; call `reset` for it next."""
        self.settings[index] = self.config.constants(bench)[0]
        self.links[index]["gain_delay"], self.links[index]["dead_time"] = gain_delay, dead_time
        self.plants[index] = plant
        self._copy(self.rows, index, plant)

    def reset(
        self,
        index: int,
        reference: ReferenceSignal,
        seed: int,
        changes: tuple[float, float] = (0.0, 0.0),
        law: Law = Law.PAPER,
    ) -> None:
        """Start from rest: disarm once, arm with `reference`, gain changes and law, take the first sample."""
        one = slice(index, index + 1)
        read = self.plants[index].reset(seed)
        self._copy(self.rows, index, self.plants[index])
        code, safe = firmware.library(), self.settings[index]["laws"][law]["safe"]
        box, command = self.boxes[one], self.commands[one]
        memory = firmware.address_of(box), firmware.address_of(self.settings[one])
        code.hydro_c_power_on(*memory, 1)
        fill_command(command, Command())
        code.hydro_c_receive(*memory, firmware.address_of(command), 0.0)
        wanted = Command(
            arm=True, reference=reference, delta_kp=changes[0], delta_ki=changes[1], filter_fresh=self.filters.fresh,
            law=law, velocity_compensation=float(safe[VELOCITY_COMPENSATION_INDEX]),
            valve_gain_scale=float(safe[VALVE_GAIN_SCALE_INDEX]),
        )  # fmt: skip
        fill_command(command, wanted)
        self.links[index]["held"] = 0.0
        self.filters.states[index] = np.zeros(1, self.filters.states.dtype)[0]
        first = self.samples[index, -1:]
        _exchange(firmware.function_addresses(), self.settings[one], box, command, self.filters, index, read, first)
        self.compensated[index, -1] = box["acting"]["reference"][0]

    def set_reference(self, index: int, reference: ReferenceSignal) -> None:
        """Command a new reference from the next sample on; the box cross-fades to it."""
        self.commands[index]["reference"] = signal_record(reference)

    def step(self, changes: FloatArray, coefficients: FloatArray | None = None) -> StateArray:
        """Advance ten samples; returns `samples`.

        `changes`: gain changes (delta_kp, delta_ki), shape (benches, 2). `coefficients`: of the compensated reference,
        shape (benches, 4); None: unchanged.
        """
        if coefficients is None:
            coefficients = self.commands["shaping"][:, :SHAPING_COEFFICIENT_COUNT]
        box = firmware.function_addresses(), self.settings, self.boxes, self.commands
        noise = np.stack([plant.noise.rows(SAMPLES_PER_STEP) for plant in self.plants])  # type: ignore[attr-defined]
        step = _step if type(self.rows).__module__.startswith("hydro_policy.") else _step_foreign
        actions = np.ascontiguousarray(changes), np.array(coefficients)
        outputs = self.samples, self.compensated
        step(*box, self.filters, self.rows, self.links, *actions, noise, *outputs)
        return self.samples

    def step_adapted(self, changes: FloatArray, adapted: AdaptedLaw | None) -> StateArray:
        """Advance ten samples as `step`, with coefficients of `adapted`, updated afterwards; None: unchanged ones."""
        if adapted is None:
            return self.step(changes)
        samples = self.step(changes, adapted.coefficients)
        active = np.all(samples["flags"] & VALIDITY_MASK == Flag.ARMED, axis=1)
        force, rate = samples["load_force"], samples["reference_force_rate"]
        adapted.step(self.compensated, force, active, rate, samples["reference_force"])
        return samples


@njit
def _exchange(code, settings, box, command, filters, i, measurement, sample):
    """Advance the box by one sample: command in, state out, and the filter's correction for the next command."""
    time = box[0].sequence * SAMPLE_PERIOD
    firmware.receive(code.receive, box, settings, command, time)
    firmware.tick(code.tick, box, settings, measurement, time, sample)
    command[0].delta_u = 0.0
    if filters.fresh:
        seen, now, acting = filters.sample[0], sample[0], box[0].acting
        copy_vector(seen.x, measurement)
        seen.nominal, seen.current = now.nominal_valve_current, now.valve_current
        seen.reference, seen.reference_rate = now.reference_force, now.reference_force_rate
        seen.k_p, seen.armed = now.proportional_gain, (now.flags & _ARMED_BIT) != 0
        seen.followed, seen.followed_rate = acting.reference, acting.reference_rate
        seen.c_1, seen.c_2 = acting.shaping[VELOCITY_COMPENSATION_INDEX], acting.shaping[VALVE_GAIN_SCALE_INDEX]
        state = filters.states[i : i + 1]
        filter_records.decide(filters.decide, filters.parameters, state, filters.sample, filters.decision)
        command[0].delta_u = filters.decision[0].delta_u


@njit
def _step(code, settings, boxes, commands, filters, plants, links, changes, coefficients, noise, samples, compensated):
    count, length = samples.shape
    for i in range(count):
        one, link = slice(i, i + 1), links[i]
        current = samples[i, length - 1].valve_current
        for k in range(length):
            for j in range(link.dead_time, 0, -1):
                link.held[j] = link.held[j - 1]
            link.held[0] = current
            advance(plants, i, noise[i, k], link.held[link.dead_time])
            if k == link.gain_delay - 1:
                commands[i].delta_kp, commands[i].delta_ki = changes[i, 0], changes[i, 1]
                for j in range(SHAPING_COEFFICIENT_COUNT):
                    commands[i].shaping[j] = coefficients[i, j]
            sample = samples[i, k : k + 1]
            read = measurement(plants, i)
            _exchange(code, settings[one], boxes[one], commands[one], filters, i, read, sample)
            current, compensated[i, k] = sample[0].valve_current, boxes[i].acting.reference


# Kinds defined elsewhere (in a benchmark): the cache's index would name a module that others cannot import.
_step_foreign = njit(_step.py_func, cache=False)


def records(samples: StateArray, fields: Sequence[str]) -> npt.NDArray[np.float64]:
    """Return fields of sample records, shape (..., len(fields))."""
    return np.stack([samples[name] for name in fields], axis=-1)
