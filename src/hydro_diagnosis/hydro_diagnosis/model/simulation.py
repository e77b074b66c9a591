# SPDX-License-Identifier: Apache-2.0
"""Forward simulation of the bench with claims, from the recorded valve current, many windows side by side.

The same effects' hooks that make the residuals make the rates here; the states are x_p, x_p', p_a, p_b by RK4. Other
elements with memory (droop, bristles, play) start in the states that the recording gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray, Kinematics, Oil
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.memory import RecordMemory, StepMemory
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench
from hydro_sim.model.hydraulics import LOAD_CELL_DAMPING

SUBSTEPS = 4
"""RK4 steps per sample: 250 us, a forty-fifth of a period of the mass-on-oil mode."""
SUBSTEPS_STICKING = 8
"""The same where the piston may stick: the time of a stop is known to one step only."""
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Grip:
    """Effect of dry friction within one step, per lane."""

    holding: FloatArray
    """N, that brings the mass to rest."""
    direction: FloatArray
    """Sign of the motion that it opposes."""
    stuck: npt.NDArray[np.bool_]
    """Whether it reaches."""

    def toward(self, motion: Kinematics) -> Kinematics:
        """The motion with a sign, also at standstill."""
        speed = np.maximum(np.abs(motion.velocity), 1e-9)
        return Kinematics(motion.time, motion.position, self.direction * speed)


@dataclass(frozen=True)
class Plant:
    """A recording and the claims with which it is simulated."""

    model: SegmentModel
    claims: tuple[Claim, ...]
    bench: Bench
    spool: FloatArray
    """A, shape (n, substeps)."""
    traces: dict[str, FloatArray]
    """Elements with memory, along the recording."""

    @classmethod
    def of(cls, model: SegmentModel, claims: Sequence[Claim]) -> Plant:
        """Prepare a recording."""
        substeps = SUBSTEPS_STICKING if _sticks(claims) else SUBSTEPS
        current = np.repeat(model.channels["valve_current"][:, None], substeps, axis=1)
        spool = chambers.spool_position(current, model.step / substeps, claims)
        memory = model.memory = RecordMemory(model.step, model.beside)
        model.chamber_run(claims)
        model.force_on_rod(claims)
        return cls(model, tuple(claims), model.bench(claims), spool, dict(memory.traces))

    def rates(
        self, state: FloatArray, time: FloatArray, spool: FloatArray, memory: StepMemory, grip: Grip | None = None
    ) -> FloatArray:
        """d/dt of [x_p, x_p', p_a, p_b], shape (4, windows); `grip`: what dry friction does in this step."""
        x, v, p_a, p_b = state
        bench, claims = self.bench, self.claims
        oil = Oil(time, x, (p_a, p_b), spool, v)
        into_a, into_b = chambers.net_flows(bench, oil, claims, memory)
        stiff_a, stiff_b = chambers.compliances(bench, oil, claims)
        motion = Kinematics(time, x, v, (p_a, p_b))
        against, level = self._dry(motion, grip), self._level(motion)
        load = bench.spring_stiffness * (x - bench.spring_rest_position)
        for claim in claims:
            against = claim.effect.resistance(against, level, motion, memory, claim.values)
            load = claim.effect.load(load, motion, bench, memory, claim.values)
        area, alpha = bench.piston_area, bench.area_ratio
        driven = area * (p_a - alpha * p_b) - bench.viscous_friction * v - against - load
        return np.stack(
            [v, driven / bench.moving_mass, stiff_a * (into_a - area * v), stiff_b * (into_b + alpha * area * v)]
        )

    def _dry(self, motion: Kinematics, grip: Grip | None) -> FloatArray:
        """Force [N] of dry friction without bristles."""
        if grip is None:
            return np.zeros_like(motion.position)
        return np.where(grip.stuck, grip.holding, self._level(grip.toward(motion)) * grip.direction)

    def _level(self, motion: Kinematics) -> FloatArray:
        level = np.zeros_like(motion.position)
        for claim in self.claims:
            level = claim.effect.drag(level, motion, claim.values)
        return level

    @property
    def sticks(self) -> bool:
        """Whether dry friction holds the piston as far as it reaches."""
        return _sticks(self.claims)

    def start(self, begins: Indices) -> FloatArray:
        """States at samples, from smoothed recordings, shape (4, windows)."""
        model = self.model
        p_a, p_b = (model.smooth(model.true_signal("pressure_" + chamber, self.claims)) for chamber in "ab")
        return np.stack([model.x[begins], model.v[begins], p_a[begins], p_b[begins]])

    def run(self, state: FloatArray, begins: Indices, length: int) -> FloatArray:
        """Simulate windows of `length` samples from `state`: as from `start`, or variants side by side.

        Returns
        -------
        Shape (length, 4, variants * windows).
        """
        variants = state.shape[1] // len(begins)
        samples = np.tile(begins, variants)
        substeps = self.spool.shape[1]
        step, states = self.model.step / substeps, np.empty((length, *state.shape))
        memory = StepMemory(step)
        memory.begin({key: trace[samples] for key, trace in self.traces.items()})
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
        grip = None
        if self.sticks:
            grip = self._grip(state, first, time, step)
            first = self.rates(state, time, spool, memory, grip)
        second = self.rates(state + 0.5 * step * first, time, spool, memory, grip)
        third = self.rates(state + 0.5 * step * second, time, spool, memory, grip)
        fourth = self.rates(state + step * third, time, spool, memory, grip)
        memory.tick()
        after = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        if grip is not None:
            after[1] = np.where(grip.stuck, 0.0, after[1])
        return after

    def _grip(self, state: FloatArray, free: FloatArray, time: FloatArray, step: float) -> Grip:
        """Dry friction brings the mass to rest within a step, as far as it reaches; `free`: rates without it."""
        holding = self.bench.moving_mass * (state[1] / step + free[1])
        grip = Grip(holding, np.sign(holding), np.zeros(holding.shape, dtype=np.bool_))
        level = self._level(grip.toward(Kinematics(time, state[0], state[1])))
        return Grip(holding, grip.direction, np.abs(holding) <= level)

    def readings(self, states: FloatArray, begins: Indices) -> dict[str, FloatArray]:
        """Return the sensors' readings of simulated states, by channel, shape (length, variants * windows)."""
        length, _, lanes = states.shape
        samples = np.tile(begins, lanes // len(begins))
        at = samples[None, :] + np.arange(length)[:, None]
        x, v, p_a, p_b = states.transpose(1, 0, 2)
        bench = self.bench
        true = {
            "piston_position": x,
            "pressure_a": p_a,
            "pressure_b": p_b,
            "hydraulic_force": bench.piston_area * (p_a - bench.area_ratio * p_b),
            "load_force": self._load(at * self.model.step, x, v, samples),
        }
        simulated = {"position": x, "velocity": v, "pressure_a": p_a, "pressure_b": p_b}
        beside = self.model.beside
        aside = {name: simulated[name] - beside[name][at] for name in simulated if name in beside}
        return {
            name: self._shown(name, signal, at, aside) for name, signal in true.items() if name in self.model.channels
        }

    def _load(self, time: FloatArray, position: FloatArray, velocity: FloatArray, samples: Indices) -> FloatArray:
        force = self.bench.spring_stiffness * (position - self.bench.spring_rest_position)
        acting = [claim for claim in self.claims if type(claim.effect).load is not Effect.load]
        memory = StepMemory(self.model.step)
        memory.begin({key: trace[samples] for key, trace in self.traces.items()})
        for k in range(len(position) if acting else 0):
            motion = Kinematics(time[k], position[k], velocity[k])
            for claim in acting:
                force[k] = claim.effect.load(force[k], motion, self.bench, memory, claim.values)
            memory.tick()
        return force

    def _shown(self, name: str, signal: FloatArray, at: Indices, aside: dict[str, FloatArray]) -> FloatArray:
        """The sensor's response to the recording's own signal plus its response to the difference from it.

        `aside`: that difference of what stands beside the sensor.
        """
        proxy = self._proxy(name)
        apart = signal - proxy[at]
        shown = self._sensor(name, proxy, self.model.memory)[at]
        nothing = np.zeros_like(apart)
        still = _ColumnMemory(self.model.step, dict.fromkeys(aside, nothing))
        memory = _ColumnMemory(self.model.step, aside)
        return shown + self._sensor(name, apart, memory) - self._sensor(name, nothing, still)

    def _proxy(self, name: str) -> FloatArray:
        if name == "piston_position":
            return self.model.channels[name]
        if name == "load_force":
            return self.model.spring_force(self.bench, self.claims, self.model.recorded)
        p_a, p_b = (self.model.smooth(self.model.true_signal("pressure_" + chamber, self.claims)) for chamber in "ab")
        if name == "hydraulic_force":
            return self.bench.piston_area * (p_a - self.bench.area_ratio * p_b)
        return p_a if name == "pressure_a" else p_b

    def _sensor(self, name: str, signal: FloatArray, memory: RecordMemory) -> FloatArray:
        if name == "load_force" and self.bench.load_cell_bandwidth is not None:
            signal = memory.low_pass(name, signal, self.bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
        for claim in self.claims:
            signal = claim.effect.measure(name, signal, memory, claim.values)
        return signal


def _sticks(claims: Sequence[Claim]) -> bool:
    """Return whether there is dry friction that no bristles carry."""
    bristled = any(claim.effect.bristles for claim in claims)
    return not bristled and any(type(claim.effect).drag is not Effect.drag for claim in claims)


class _ColumnMemory(RecordMemory):
    """A record memory whose time runs down the first axis, one column per window."""

    def low_pass(self, key: str, signal: FloatArray, bandwidth: float, damping: float) -> FloatArray:
        single = super().low_pass
        return np.apply_along_axis(lambda column: single(key, column, bandwidth, damping), 0, signal)

    def lag(self, key: str, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        single = super().lag
        return np.apply_along_axis(lambda column: single(key, column, time_constant, start), 0, signal)

    def turning(self, signal: FloatArray, rising: float, falling: float) -> FloatArray:
        return np.apply_along_axis(
            lambda column: super(_ColumnMemory, self).turning(column, rising, falling), 0, signal
        )
