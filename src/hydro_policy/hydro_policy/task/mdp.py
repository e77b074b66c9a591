# SPDX-License-Identifier: Apache-2.0
"""The task as a Markov decision process: observation (eq. obs), reward (eq. reward), action (eq. policy_action).

observation  13 numbers, each (value - center) / scale, both a share of the bench's size
action       2 numbers in [-1, 1], mapped linearly to [delta_kp, delta_ki]
step         10 box samples of 1 ms; an episode is 1800 steps, 18 s

Samples make steps by their sequence numbers, so that the policy runs on the plant's clock:

sequence   ... 19 | 20 21 22 23 24 25 26 27 28 29 | 30 ...
                    ^ step: observe, act            ^ step: reward of that action = mean over samples 21 to 30
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from hydro_core.settings import quantity
from hydro_core.signals import (
    PLANT_FIELDS,
    SAMPLES_PER_STEP,
    STATE_FIELDS,
    Flag,
    FloatArray,
    ReferenceSignal,
    Waveform,
)
from hydro_core.size import Size
from hydro_sim.model.bench import NOMINAL

ACTIONS = 2

BASE = (15.0, 5.0)
"""Base gains K_p [1/s], K_i [1/s^2] of the paper's box (Table training_agent); a box reports its own."""

_SPREAD: FloatArray = np.array((0.7548776662466927, 0.5698402909980532))  # 1 / p, 1 / p^2 with p^3 = p + 1

_NORMALIZATION: tuple[tuple[str, str, float, float], ...] = (  # name; scale of `Size`; center and reach of normal runs
    ("hydraulic_force", "force", 0.0, 1.0),
    ("hydraulic_force_rate", "force", 0.0, 3770.0 / 300.0),  # 1/s: the usual amplitude at 2 Hz
    ("load_force", "force", 0.0, 1.0),
    ("load_force_rate", "force", 0.0, 3770.0 / 300.0),
    ("pressure_a", "pressure", 0.53125, 0.34375),  # 3 to 14 MPa of 16
    ("pressure_b", "pressure", 0.53125, 0.34375),
    ("piston_position", "length", 0.5, 0.1875),  # the usual amplitude on the spring about mid-stroke
    ("piston_velocity", "length", 0.0, 2.375),  # 1/s: that at 2 Hz
    ("reference_force", "force", 0.0, 1.0),
    ("reference_force_rate", "force", 0.0, 3770.0 / 300.0),
    ("error", "force", 0.0, 0.1),  # an order below the reference, or the policy would hardly see it
    ("previous_action_kp", "", 0.0, 1.0),
    ("previous_action_ki", "", 0.0, 1.0),
)
OBSERVATION_NAMES = tuple(name for name, *_ in _NORMALIZATION)
OBSERVATIONS = len(OBSERVATION_NAMES)

LOAD_FORCE, LOAD_FORCE_RATE = STATE_FIELDS.index("load_force"), STATE_FIELDS.index("load_force_rate")
REFERENCE, REFERENCE_RATE = STATE_FIELDS.index("reference_force"), STATE_FIELDS.index("reference_force_rate")
_PLANT = len(PLANT_FIELDS)


@dataclass(frozen=True, kw_only=True)
class GainRange:
    """Range of the gain changes: actions in [-1, 1] cover [min, max] (paper Table training_agent)."""

    delta_kp_min: Annotated[float, quantity("1/s", -300.0, 300.0)] = 0.0
    """Smallest change of K_p."""
    delta_kp_max: Annotated[float, quantity("1/s", -300.0, 300.0)] = 75.0
    """Largest change of K_p, above delta_kp_min; with the paper's base gain 15, 285 gives the wide authority K_p <=
    300.
    """
    delta_ki_min: Annotated[float, quantity("1/s^2", -100.0, 100.0)] = 0.0
    """Smallest change of K_i."""
    delta_ki_max: Annotated[float, quantity("1/s^2", -100.0, 100.0)] = 10.0
    """Largest change of K_i, above delta_ki_min."""

    @classmethod
    def enclosing(cls, *ranges: Any) -> GainRange:
        """Return the smallest range that holds all of these: gain ranges, or what has their four limits."""
        return cls(
            delta_kp_min=min(one.delta_kp_min for one in ranges), delta_kp_max=max(one.delta_kp_max for one in ranges),
            delta_ki_min=min(one.delta_ki_min for one in ranges), delta_ki_max=max(one.delta_ki_max for one in ranges),
        )  # fmt: skip

    def shifted(self, kp: float, ki: float) -> GainRange:
        """Return the range shifted by these amounts: equal total gains on a box with base gains lower by as much."""
        return GainRange(
            delta_kp_min=self.delta_kp_min + kp, delta_kp_max=self.delta_kp_max + kp,
            delta_ki_min=self.delta_ki_min + ki, delta_ki_max=self.delta_ki_max + ki,
        )  # fmt: skip

    def gains(self, action: FloatArray) -> tuple[float, float]:
        """Return (delta_kp, delta_ki) of an action [2]; an action beyond [-1, 1] is clamped."""
        kp, ki = self.changes(action)
        return float(kp), float(ki)

    def changes(self, actions: FloatArray) -> FloatArray:
        """Return `gains` of many actions, shape (..., 2) to (..., 2)."""
        low = np.array((self.delta_kp_min, self.delta_ki_min))
        high = np.array((self.delta_kp_max, self.delta_ki_max))
        return np.asarray(low + 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0) * (high - low))

    def action(self, delta_kp: float, delta_ki: float) -> FloatArray:
        """Return the action [2] for these gains; not clamped."""
        low = np.array((self.delta_kp_min, self.delta_ki_min))
        high = np.array((self.delta_kp_max, self.delta_ki_max))
        return np.asarray(2.0 * (np.array((delta_kp, delta_ki)) - low) / (high - low) - 1.0)


@dataclass(frozen=True, kw_only=True)
class TaskSettings:
    """Reward, gains, episodes (paper eq. reward, Table training_agent; units from physics.md)."""

    error_weight: Annotated[float, quantity("-", 0.0, 1e6)] = 100.0
    """Q_1, on the square of e / force_scale."""
    error_rate_weight: Annotated[float, quantity("-", 0.0, 1e6)] = 4000.0
    """Q_2, on the square of e' / force_rate_scale."""
    force_scale: Annotated[float, quantity("N", 1e-3, 1e7)] = NOMINAL.force
    """Of the error in the reward."""
    force_rate_scale: Annotated[float, quantity("N/s", 1e-3, 1e8)] = NOMINAL.force * 2.0 * math.pi * 2.0
    """Of the error's rate in the reward: `force_scale` at 2 Hz."""
    reward_power: Annotated[float, quantity("-", 0.1, 2.0)] = 2.0
    """Of the reward: 2 is the paper's square, 1 its root, which weighs small errors on slow references more."""
    trip_penalty: Annotated[float, quantity("-", 0.0, 1e6)] = 1000.0
    """Taken from the reward when the box trips (force limit, sensor fault), which ends the episode."""
    steps_per_episode: Annotated[int, quantity("-", 10, 1e6)] = 1800
    """Policy steps, 10 ms each."""
    amplitude_min: Annotated[float, quantity("N", 0.0, 1e7)] = NOMINAL.force * 2.0 / 3.0
    """Smallest amplitude of a reference."""
    amplitude_max: Annotated[float, quantity("N", 0.0, 1e7)] = NOMINAL.force
    """Largest amplitude of a reference."""
    frequency_min: Annotated[float, quantity("Hz", 0.05, 10.0)] = 0.5
    """Lowest frequency of a reference."""
    frequency_max: Annotated[float, quantity("Hz", 0.05, 10.0)] = 2.0
    """Highest frequency of a reference."""
    gains: GainRange = field(default_factory=GainRange)
    size: Size = NOMINAL
    """Of the bench: what observations are scaled with."""

    def reward(self, error: FloatArray, error_rate: FloatArray) -> FloatArray:
        """Return eq. reward (at power 2) of the means over an action's samples: e [N], e' [N/s], (..., n) to (...).

        The paper evaluates it at one instant, where the derivative's noise alone contributes -20 per step. In the mean
        over ten samples, which is the change of e over the step, it contributes -2; the weight of tracking is the same.
        """
        e, de = np.mean(error, axis=-1) / self.force_scale, np.mean(error_rate, axis=-1) / self.force_rate_scale
        return np.asarray(
            -((self.error_weight * e * e + self.error_rate_weight * de * de) ** (0.5 * self.reward_power))
        )

    def reference(self, episode: int, seed: int) -> ReferenceSignal:
        """Return the sine of an episode: amplitude and frequency spread evenly over their ranges, from a random start.

        Independent draws leave corners of the ranges unvisited for dozens of episodes; this sequence (Roberts' R2, from
        the plastic number) is also uniform, and any eight consecutive episodes cover the plane.
        """
        start = np.random.default_rng(seed).random(2)
        amplitude, frequency = (start + episode * _SPREAD) % 1.0
        return ReferenceSignal(
            waveform=Waveform.SINE,
            amplitude=self.amplitude_min + float(amplitude) * (self.amplitude_max - self.amplitude_min),
            frequency=self.frequency_min + float(frequency) * (self.frequency_max - self.frequency_min),
        )


@lru_cache
def normalization(size: Size) -> tuple[FloatArray, FloatArray]:
    """Return center and scale of the observations on a bench of this size, shape (13,) each."""
    scales = vars(size) | {"": 1.0}
    center = np.array([scales[scale] * share for _, scale, share, _ in _NORMALIZATION])
    return center, np.array([scales[scale] * share for _, scale, _, share in _NORMALIZATION])


def observe(sample: FloatArray, previous_action: FloatArray, size: Size) -> FloatArray:
    """Return eq. obs, normalized: o = [x, f_r, f_r', e, previous action], shape (..., 13).

    Parameters
    ----------
    sample
        Samples in the order of `STATE_FIELDS`, shape (..., 14), SI units.
    previous_action
        Shape (..., 2), within [-1, 1].
    size
        Of the bench.
    """
    center, scale = normalization(size)
    observation = np.empty((*sample.shape[:-1], OBSERVATIONS))
    observation[..., :_PLANT] = sample[..., :_PLANT]
    observation[..., _PLANT] = sample[..., REFERENCE]
    observation[..., _PLANT + 1] = sample[..., REFERENCE_RATE]
    observation[..., _PLANT + 2] = sample[..., REFERENCE] - sample[..., LOAD_FORCE]
    observation[..., _PLANT + 3 :] = previous_action
    observation -= center
    observation /= scale
    return observation


HELD = int(Flag.WATCHDOG | Flag.FILTER_STALE)
"""Flags with which the box held base gains, so that the result is not due to the action: see `held`."""

VALVE_CURRENT, KP, KI = map(STATE_FIELDS.index, ("valve_current", "proportional_gain", "integral_gain"))


def held(flags: Any, k_p: Any, k_i: Any, base: tuple[float, float] | None) -> Any:
    """Return the bits of `HELD` with which the box held base gains.

    A plant that requires no filter (`guard.require_filter`) passes other gains with FILTER_STALE, too: they act.

    `flags`, `k_p`, `k_i`: of one sample, or arrays of one shape; 1/s and 1/s^2. `base`: base gains K_p, K_i; None: each
    flagged sample counts (MISMATCH, under which narrow gains act; another law).
    """
    bits = flags & HELD
    if base is None:
        return bits
    acts = ~(np.isclose(k_p, base[0], rtol=1e-5) & np.isclose(k_i, base[1], rtol=1e-5))
    return np.where(acts & (bits == Flag.FILTER_STALE), 0, bits)


@dataclass(frozen=True)
class Step:
    """Policy step: the sample to act upon, and the results of the previous action."""

    sample: FloatArray  # the step's own sample, order of STATE_FIELDS, shape (14,)
    error: FloatArray  # e [N] of the samples since the last step, this one included, shape (n,)
    error_rate: FloatArray  # e' [N/s], shape (n,)
    current: FloatArray  # consecutive u [A] received by the valve: if samples are missing, only those after the gap
    whole: bool  # every sample arrived, armed, and the box applied the gains it was given
    held: int  # bits of HELD seen since the last step


class StepClock:
    """Collects samples; every tenth sequence number completes a step.

    If that very sample is lost, the next one to arrive is the step: acting continues, but the step is not `whole`.
    """

    def __init__(self) -> None:
        self._samples: list[FloatArray] = []  # since the last step
        self._unbroken = 0  # place among them from which on none is missing
        self._last = -1
        self._held = 0
        self._common = ~0
        self._gap = True
        self.lost = 0
        """Sequence numbers that never arrived."""

    def add(
        self, sequence: int, sample: FloatArray, flags: int, base: tuple[float, float] | None = None
    ) -> Step | None:
        """Add a sample, which stays as it is from now on; returns the step that it completes, if any.

        Repeated samples are ignored. `base`: of `held`.
        """
        if sequence == self._last:
            return None
        if sequence != self._last + 1:
            self._gap, self._unbroken = True, len(self._samples)
            self.lost += max(sequence - self._last - 1, 0) if self._last >= 0 else 0
        block_changed = sequence // SAMPLES_PER_STEP != self._last // SAMPLES_PER_STEP
        self._last = sequence
        self._samples.append(sample)
        if flags & HELD:
            self._held |= int(held(flags, sample[KP], sample[KI], base))
        self._common &= flags
        return self._complete(sample) if block_changed else None

    def _complete(self, sample: FloatArray) -> Step:
        complete = not self._gap and len(self._samples) == SAMPLES_PER_STEP
        whole = complete and not self._held and bool(self._common & Flag.ARMED)
        rows = np.array(self._samples)
        error, rate = rows[:, REFERENCE] - rows[:, LOAD_FORCE], rows[:, REFERENCE_RATE] - rows[:, LOAD_FORCE_RATE]
        step = Step(sample, error, rate, rows[self._unbroken :, VALVE_CURRENT], whole, self._held)
        self._samples, self._unbroken, self._held, self._common, self._gap = [], 0, 0, ~0, False
        return step
