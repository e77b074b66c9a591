# SPDX-License-Identifier: Apache-2.0
"""A learned model as a `hydro_sim.model.plant.Plant`, for the sim node and the offline loop.

The model gives x without noise. The sensors' noise and quantisation go through the box's differentiation by themselves
and are added: conditioning is linear, so x comes out as if the readings had been noisy.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.jit import njit
from hydro_sim.learned import region
from hydro_sim.learned.model import Learned
from hydro_sim.model import sensors
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Noise, Sensors
from hydro_sim.structured import integration, rollout
from hydro_sim.structured.model import StructuredModel
from hydro_sim.structured.rollout import INPUTS, OUTPUTS

Step = Callable[[FloatArray, float, FloatArray], None]
"""Advances a state [in place] under a current [A] and writes x, shape (8,)."""


class LearnedPlant:
    """See the module.

    Parameters
    ----------
    learned
        The model; None: the one that comes with this package.
    noise
        Scale of the sensors' noise and quantisation, 0 or more.
    settings
        The sensors at scale 1.
    """

    def __init__(
        self, learned: Learned | str | Path | None = None, *, noise: float = 1.0, settings: Sensors | None = None
    ) -> None:
        if not 0.0 <= noise < np.inf:
            raise ValueError(f"noise scale {noise!r} is not a number of 0 or more")
        self.learned = learned if isinstance(learned, Learned) else Learned.load(learned)
        model = self.learned.model
        self.advance = _structured_step(model)
        self.sensors = (settings or Sensors()).constants(noise)
        self.noise = Noise(0)
        self.state = np.array(model.rest)
        self.clean, self.error = np.zeros(8), np.zeros(8)
        self._last = np.zeros(1, CONDITIONING_DTYPE)
        self.extrapolating = False
        """Whether the last state or current lay outside of what the model was trained on."""
        self.reset(0)
        self.step(0.0)  # compiles
        self.reset(0)

    def reset(self, seed: int) -> FloatArray:
        """See `hydro_sim.model.plant.Plant.reset`."""
        self.noise, self.extrapolating = Noise(seed), False
        self.state[:] = self.learned.model.rest
        self.clean[:] = _measured(self.state)
        _begin_error(self.sensors, self.noise.row(), self.clean, self._last, self.error)
        return self.clean + self.error

    def step(self, valve_current: float) -> FloatArray:
        """See `hydro_sim.model.plant.Plant.step`."""
        self.advance(self.state, valve_current, self.clean)
        bounds = self.learned.region
        self.extrapolating = bool(region.outside(bounds.center, bounds.whiten, self.clean, valve_current))
        next_error(self.sensors, self.noise.row(), self.clean, self._last, self.error)
        return self.clean + self.error


def _measured(state: FloatArray) -> FloatArray:
    """x of a full state at rest."""
    return np.array([state[6], 0.0, state[6], 0.0, state[0], state[1], state[2], 0.0])


def _structured_step(model: StructuredModel) -> Step:
    """(state (12,), current, x out (8,)) of a structured model."""
    compiled = model.compiled
    work = integration.scratch()
    x, r = np.empty(INPUTS), np.empty(OUTPUTS)
    a1, a2 = np.empty(model.hidden[0]), np.empty(model.hidden[1])

    def step(state: FloatArray, current: float, measured: FloatArray) -> None:
        rollout.advance_full(*compiled, state, current, work, x, a1, a2, r, measured)

    return step


@njit
def _errors(sensor, noise, clean, raw):
    """Errors that the sensors add to the five readings."""
    raw[0], raw[1], raw[2], raw[3], raw[4] = clean[0], clean[2], clean[4], clean[5], clean[6]
    sensors.sense(sensor, noise, raw)
    raw[0] -= clean[0]
    raw[1] -= clean[2]
    raw[2] -= clean[4]
    raw[3] -= clean[5]
    raw[4] -= clean[6]


@njit
def _begin_error(sensor, noise, clean, last, error):
    raw = np.empty(5)
    _errors(sensor[0], noise, clean, raw)
    sensors.restart(last[0], raw, error)


@njit
def next_error(sensor, noise, clean, last, error):
    """The sensors' error of the next sample, rates included, in place."""
    raw = np.empty(5)
    _errors(sensor[0], noise, clean, raw)
    sensors.condition(sensor[0], last[0], raw, error)
