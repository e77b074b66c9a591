# SPDX-License-Identifier: Apache-2.0
"""`TruthPlant`: the emulated bench behind the interface of `hydro_sim.model.plant.Plant`."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, FloatArray
from hydro_sim.emulator.truth import dynamics, sensing
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.emulator.truth.parameters import SUBSTEPS, compile_parameters
from hydro_sim.jit import njit
from hydro_sim.model.sensors import Noise, Sensors

NOISE_COLUMNS = 5  # f_h, f_l, p_a, p_b, random force

TRUTH_FIELDS = (
    *PLANT_FIELDS,
    "spool",  # A, of the command that would hold it
    "friction_force",  # N, dry and viscous, against motion
    "supply_pressure",  # Pa
    "valve_draw",  # m3/s, from the supply
)
"""Columns of the physical log: the state before any sensor, then what no sensor sees."""


@njit
def advance(p, box, state, chain, work, noise, current):
    """Advance by one sample of 1 ms in place: physics, amplifiers, reading. Every path through the emulator runs it.

    Parameters
    ----------
    p, box, state, chain
        Arrays of shape (1,): plant parameters, the box's differentiation, physical state, sensors.
    work
        Scratch space, shape (3, 8).
    noise
        Standard normal numbers, shape (`NOISE_COLUMNS`,).
    current
        Valve current [A], held over the sample.
    """
    dynamics.hold_command(p[0], state[0], current, noise[4])
    for index in range(SUBSTEPS):
        dynamics.advance_substep(p[0], state[0], index, work)
        sensing.follow(p[0], state[0], chain[0])
    sensing.read(p[0], box[0], chain[0], noise)


@njit
def start(p, box, state, chain, noise):
    """Set the bench at rest, with its first reading; shapes as in `advance`."""
    dynamics.rest_state(p[0], state[0])
    sensing.start(p[0], box[0], state[0], chain[0], noise)


@njit
def physical(state, row):
    """Copy the physical quantities into `row`, shape (len(`TRUTH_FIELDS`),)."""
    s = state[0]
    row[0], row[1], row[2], row[3] = s.hydraulic_force, s.hydraulic_force_rate, s.load_force, s.load_force_rate
    row[4], row[5], row[6], row[7] = s.pressure_a, s.pressure_b, s.y[2], s.y[3]
    row[8], row[9], row[10], row[11] = s.y[4], s.friction_force, s.y[6], s.draw


class TruthPlant:
    """The emulated bench; implements `hydro_sim.model.plant.Plant`.

    Parameters
    ----------
    config
        Configuration of the bench.
    seed
        Of the sensors' noise and the random force.
    """

    def __init__(self, config: TruthConfig, seed: int = 0) -> None:
        self.config = config
        self.parameters = compile_parameters(config)
        ages = config.sensors
        self.differentiation = Sensors(force_rate_age=ages.force_rate_age, velocity_age=ages.velocity_age).constants()
        self.state = np.zeros(1, dynamics.STATE)
        self.chain = np.zeros(1, sensing.CHAIN)
        self.work = np.zeros((3, 8))
        self.reset(seed)

    def reset(self, seed: int) -> FloatArray:
        """Reset to rest, with noise from `seed`; return the measurement x, shape (8,)."""
        self.noise = Noise(seed)
        start(self.parameters, self.differentiation, self.state, self.chain, self.noise.row())
        return self.measurement()

    def step(self, valve_current: float) -> FloatArray:
        """Hold `valve_current` [A] for 1 ms; return the measurement x after it, shape (8,)."""
        advance(
            self.parameters, self.differentiation, self.state, self.chain, self.work, self.noise.row(), valve_current
        )
        return self.measurement()

    def measurement(self) -> FloatArray:
        """Present measurement x (eq. state_def), shape (8,), SI units; a copy."""
        return self.chain["measurement"][0].copy()
