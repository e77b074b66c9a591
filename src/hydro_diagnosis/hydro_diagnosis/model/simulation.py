# SPDX-License-Identifier: Apache-2.0
"""Forward simulation of the bench with claims, from the recorded valve current, many windows in parallel.

The rates come from the same hooks of effects as the residuals; the states x_p, x_p', p_a, p_b are integrated by RK4.
Other elements with memory (droop, bristles, play) start from their states along the recording. A sensor's reading is
its response to the recording plus that to the deviation of the simulated states from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import ChamberInputs, EffectHypothesis, FloatArray, Kinematics, claims_acting_in
from hydro_diagnosis.effects.memory import ColumnMemory, Memory, StepMemory, WindowMemory, WindowStarts
from hydro_diagnosis.model import chambers
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING

if TYPE_CHECKING:
    from hydro_diagnosis.model.segment_model import SegmentModel


def measurements(plant: Plant, states: FloatArray, begins: WindowStarts) -> dict[str, FloatArray]:
    """Return the sensors' readings of simulated states, by channel, shape (length, variants * windows)."""
    length, _, lanes = states.shape
    samples = np.tile(begins, lanes // len(begins))
    at = samples[None, :] + np.arange(length)[:, None]
    x, v, p_a, p_b = states.transpose(1, 0, 2)
    bench, acceleration = plant.bench, _accelerations(plant, states, samples)
    true = {
        "piston_position": x,
        "pressure_a": p_a,
        "pressure_b": p_b,
        "hydraulic_force": eq.hydraulic_force(bench, p_a, p_b),
        "load_force": _load(plant, Kinematics(at * plant.model.step, x, v, None, acceleration), samples),
    }
    simulated = {"position": x, "velocity": v, "pressure_a": p_a, "pressure_b": p_b, "acceleration": acceleration}
    recorded = plant.model.other_signals
    differences = {name: simulated[name] - recorded[name][at] for name in simulated if name in recorded}
    return {
        name: _shown(plant, name, signal, at, differences)
        for name, signal in true.items()
        if name in plant.model.channels
    }


def _accelerations(plant: Plant, states: FloatArray, samples: WindowStarts) -> FloatArray:
    """Acceleration [m/s2] along windows, shape (length, windows), if any claim depends on it; else 0."""
    found = np.zeros_like(states[:, 1])
    memory = plant.memory(samples, plant.model.step)
    for k in range(len(states) if any(claim.effect.depends_on_acceleration for claim in plant.claims) else 0):
        time = np.asarray(plant.model.segment.start + (samples + k) * plant.model.step)
        spool = plant.spool[np.minimum(samples + k, len(plant.spool) - 1), 0][:, None]
        motion = Kinematics(time, states[k, 0], states[k, 1])
        dry = (
            0.0
            if not plant.has_stiction
            else np.sign(motion.velocity) * plant.dry_friction_magnitude(motion) / plant.mass(motion)
        )
        found[k] = plant.rates(states[k], time, spool, memory)[1] - dry
        memory.tick()
    return found


def _load(plant: Plant, motions: Kinematics, samples: WindowStarts) -> FloatArray:
    position, acceleration = motions.position, motions.acceleration
    force: FloatArray = eq.spring_force(plant.bench, position)
    acting = plant.acting["load"]
    memory = plant.memory(samples, plant.model.step)
    for k in range(len(position) if acting else 0):
        now = None if acceleration is None else acceleration[k]
        motion = Kinematics(motions.time[k], position[k], motions.velocity[k], None, now)
        for claim in acting:
            force[k] = claim.effect.load(force[k], motion, plant.bench, memory, claim.values)
        memory.tick()
    return force


def _shown(
    plant: Plant, name: str, signal: FloatArray, at: WindowStarts, differences: dict[str, FloatArray]
) -> FloatArray:
    """The sensor's response to the recording's own signal plus its response to the difference from it.

    A reading that depends on the instant or on a path alone is evaluated at the full signal: it may be nonlinear.

    `differences`: simulated less recorded signals on which the reading may depend besides its own.
    """
    proxy, record = _proxy(plant, name), plant.model.memory
    apart = signal - proxy[at]
    nothing = np.zeros_like(apart)
    still = ColumnMemory(plant.model.step, dict.fromkeys(differences, nothing))
    memory = ColumnMemory(plant.model.step, differences)
    if name == "load_force" and plant.bench.load_cell_bandwidth is not None:
        cell = plant.bench.load_cell_bandwidth, LOAD_CELL_DAMPING
        proxy, apart = record.low_pass(name, proxy, *cell), memory.low_pass(name, apart, *cell)
    for claim in plant.claims:
        shown = claim.effect.read_sensor(name, proxy, record, claim.values)
        if shown is proxy:
            continue
        if claim.effect.has_no_time_filter:
            both = {
                key: plant.model.other_signals[key][at] + differences.get(key, 0.0) for key in plant.model.other_signals
            }
            there = WindowMemory(plant.model.step, both, record.traces, at)
            apart = claim.effect.read_sensor(name, proxy[at] + apart, there, claim.values) - shown[at]
        else:
            with_it, without = (
                claim.effect.read_sensor(name, one, past, claim.values)
                for one, past in ((apart, memory), (nothing, still))
            )
            apart = with_it - without
        proxy = shown
    if name == "piston_position":
        apart = apart + (plant.channels[name] - plant.model.channels[name])[at]
    return proxy[at] + apart


def _proxy(plant: Plant, name: str) -> FloatArray:
    if name == "piston_position":
        return plant.model.channels[name]
    if name == "load_force":
        return plant.model.load_force(plant.bench, plant.claims, plant.model.recorded)
    p_a, p_b = (plant.model.smooth(plant.model.true_signal("pressure_" + chamber, plant.claims)) for chamber in "ab")
    if name == "hydraulic_force":
        force: FloatArray = eq.hydraulic_force(plant.bench, p_a, p_b)
        return force
    return p_a if name == "pressure_a" else p_b


@dataclass(frozen=True)
class StictionStep:
    """Stiction within one integration step, per lane."""

    holding_force: FloatArray
    """Force [N] that brings the mass to rest within the step."""
    direction: FloatArray
    """Sign of the motion that dry friction opposes."""
    sticks: npt.NDArray[np.bool_]
    """Whether dry friction reaches the holding force."""

    def toward(self, motion: Kinematics) -> Kinematics:
        """Return the motion with its velocity in `direction`, at least 1e-9 m/s: signed also at standstill."""
        speed = np.maximum(np.abs(motion.velocity), 1e-9)
        return Kinematics(motion.time, motion.position, self.direction * speed)


@dataclass(frozen=True)
class Plant:
    """Plant under claims, to be simulated from any sample of a recording."""

    model: SegmentModel
    claims: tuple[EffectHypothesis, ...]
    bench: Bench
    spool: FloatArray
    """Spool position [A], shape (n, substeps)."""
    traces: dict[str, FloatArray]
    """States of the elements with memory along the recording, by key."""
    channels: Mapping[str, FloatArray]
    """Channels as recorded; the position of `model` is corrected by the claims."""
    has_stiction: bool
    """Whether dry friction causes stiction: not if bristles represent it."""

    @classmethod
    def of(cls, model: SegmentModel, claims: Sequence[EffectHypothesis]) -> Plant:
        """Return the plant of a recording under claims: spool path and states of memory along it are computed."""
        has_stiction = bool(claims_acting_in(claims, "dry_level")) and not any(
            claim.effect.models_presliding for claim in claims
        )
        substeps = chambers.SUBSTEPS * (2 if has_stiction else 1)
        channels, model = model.channels, model.with_true_position(claims)
        claims = [claim for claim in claims if not claim.effect.is_position_error]
        spool = np.repeat(model.channels["valve_current"][:, None], substeps, axis=1)
        for claim in sorted(claims_acting_in(claims, "command"), key=lambda claim: claim.effect.stage):
            spool = claim.effect.command(spool, Memory(model.step / substeps), claim.values)
        memory = model.memory = Memory(model.step, model.other_signals)
        model.chamber_run(claims)
        model.required_force(claims)
        for claim in claims:
            claim.effect.trace(model.kinematics, memory, claim.values)
        if "load_force" in model.channels:
            model.load_force(model.bench(claims), claims, model.recorded)
        return cls(model, tuple(claims), model.bench(claims), spool, dict(memory.traces), channels, has_stiction)

    def rates(
        self,
        state: FloatArray,
        time: FloatArray,
        spool: FloatArray,
        memory: StepMemory,
        stiction: StictionStep | None = None,
    ) -> FloatArray:
        """d/dt of [x_p, x_p', p_a, p_b], shape (4, windows); `stiction` of this step; None: without dry friction."""
        x, v, p_a, p_b = state
        bench = self.bench
        oil = ChamberInputs(time, x, (p_a, p_b), spool, v)
        into_a, into_b = chambers.net_flows(bench, oil, self.acting["hydraulic"], memory)
        stiff_a, stiff_b = chambers.chamber_stiffnesses(bench, oil, self.acting["hydraulic"])
        motion = Kinematics(time, x, v, (p_a, p_b))
        against = self._dry(motion, stiction)
        level = self.dry_friction_magnitude(motion) if self.acting["opposing_force"] else against
        for claim in self.acting["opposing_force"]:
            against = claim.effect.opposing_force(against, level, motion, memory, claim.values)
        load = eq.spring_force(bench, x)
        for claim in self.acting["load"]:
            load = claim.effect.load(load, motion, bench, memory, claim.values)
        rates = np.empty_like(state)
        chambers.derivatives(rates, self._numbers, state, into_a, into_b, stiff_a, stiff_b, against, load)
        if self.acting["inertia"]:
            rates[1] *= bench.moving_mass / self.mass(motion)
        return rates

    @cached_property
    def acting(self) -> dict[str, tuple[EffectHypothesis, ...]]:
        """Claims by the hook of `Effect` in which they act; `hydraulic`: those of the chamber equations."""
        found = {
            hook: tuple(claims_acting_in(self.claims, hook))
            for hook in ("dry_level", "opposing_force", "load", "inertia")
        }
        # the spool's path is computed beforehand
        return {"hydraulic": tuple(claims_acting_in(self.claims, "openings", "supply", "leaks", "modulus")), **found}

    def mass(self, motion: Kinematics) -> FloatArray | float:
        """Return the moving mass [kg], including that moved with the load."""
        return self.bench.moving_mass + sum(
            claim.effect.inertia(motion, self.bench, claim.values) for claim in self.acting["inertia"]
        )

    @cached_property
    def _numbers(self) -> np.void:
        """Record of the bench's constants for compiled code."""
        numbers: np.void = self.bench.constants()[0]
        return numbers

    def _dry(self, motion: Kinematics, stiction: StictionStep | None) -> FloatArray:
        """Force [N] of dry friction without bristles."""
        if stiction is None:
            return np.zeros_like(motion.position)
        return np.where(
            stiction.sticks,
            stiction.holding_force,
            self.dry_friction_magnitude(stiction.toward(motion)) * stiction.direction,
        )

    def dry_friction_magnitude(self, motion: Kinematics) -> FloatArray:
        """Return the largest force [N] of dry friction, shape (windows,)."""
        level = np.zeros_like(motion.position)
        for claim in self.acting["dry_level"]:
            level = claim.effect.dry_level(level, motion, claim.values)
        return level

    def memory(self, samples: WindowStarts, step: float) -> StepMemory:
        """Return the memory of windows that start at these samples, advanced one `step` [s] at a time."""
        return StepMemory(step, {key: trace[samples] for key, trace in self.traces.items()})

    def start(self, begins: WindowStarts) -> FloatArray:
        """Return initial states of windows, from the smoothed recording, shape (4, windows)."""
        model = self.model
        p_a, p_b = (model.smooth(model.true_signal("pressure_" + chamber, self.claims)) for chamber in "ab")
        return np.stack([model.x[begins], model.v[begins], p_a[begins], p_b[begins]])

    def run(self, state: FloatArray, begins: WindowStarts, length: int) -> FloatArray:
        """Simulate windows of `length` samples from `state`, as of `start`, shape (4, variants * windows).

        Returns
        -------
        Shape (length, 4, variants * windows).
        """
        variants = state.shape[1] // len(begins)
        samples = np.tile(begins, variants)
        substeps = self.spool.shape[1]
        step, states = self.model.step / substeps, np.empty((length, *state.shape))
        if not any(self.acting.values()):  # all claims change numbers of the bench, the spool's path or sensors
            chambers.simulate_nominal(states, self._numbers, np.ascontiguousarray(state), samples, self.spool, step)
            return states
        memory = self.memory(samples, step)
        for k in range(length):
            states[k] = state
            for s in range(substeps):
                seconds = self.model.segment.start + (samples + k) * self.model.step + s * step
                time = np.asarray(seconds, dtype=np.float64)
                spool = self.spool[samples + k, s][:, None]
                state = self._step(state, time, spool, memory, step)
        return states

    def _step(
        self, state: FloatArray, time: FloatArray, spool: FloatArray, memory: StepMemory, step: float
    ) -> FloatArray:
        first = self.rates(state, time, spool, memory)
        stiction = None
        if self.has_stiction:  # dry friction brings the mass to rest within a step, as far as it reaches
            motion = Kinematics(time, state[0], state[1])
            holding = np.asarray(self.mass(motion) * (state[1] / step + first[1]))
            stiction = StictionStep(holding, np.sign(holding), np.zeros(holding.shape, dtype=np.bool_))
            stiction = replace(stiction, sticks=np.abs(holding) <= self.dry_friction_magnitude(stiction.toward(motion)))
            first[1] -= self._dry(motion, stiction) / self.mass(motion)
        second = self.rates(state + 0.5 * step * first, time, spool, memory, stiction)
        third = self.rates(state + 0.5 * step * second, time, spool, memory, stiction)
        fourth = self.rates(state + step * third, time, spool, memory, stiction)
        memory.tick()
        after = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        if stiction is not None:
            after[1] = np.where(stiction.sticks, 0.0, after[1])
        return after
