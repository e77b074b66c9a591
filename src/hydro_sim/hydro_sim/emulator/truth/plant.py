# SPDX-License-Identifier: Apache-2.0
"""`TruthPlant`: the emulated bench behind the interface of `hydro_sim.model.plant.Plant`."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, FloatArray
from hydro_sim.emulator.truth import dynamics, sensing
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.emulator.truth.parameters import SUBSTEPS, compile_parameters
from hydro_sim.jit import njit
from hydro_sim.model.sensors import Sensors

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


@njit
def _run(p, box, state, chain, work, noise, currents, noisy, clean, truth):
    for k in range(len(currents)):
        advance(p, box, state, chain, work, noise[k], currents[k])
        noisy[k], clean[k] = chain[0].measurement, chain[0].clean
        physical(state, truth[k])


class NoiseStream:
    """Standard normal numbers by rows, independent of how many are taken at a time."""

    BLOCK = 1024

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._rows: FloatArray = np.empty((0, NOISE_COLUMNS))
        self._next = 0

    def row(self) -> FloatArray:
        """Next row, shape (`NOISE_COLUMNS`,)."""
        if self._next == len(self._rows):
            self._rows, self._next = self._generator.standard_normal((self.BLOCK, NOISE_COLUMNS)), 0
        self._next += 1
        return self._rows[self._next - 1]

    def rows(self, count: int) -> FloatArray:
        """Next `count` rows, shape (count, `NOISE_COLUMNS`)."""
        kept = self._rows[self._next : self._next + count]
        self._next += len(kept)
        return np.concatenate((kept, self._generator.standard_normal((count - len(kept), NOISE_COLUMNS))))


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
        self.noise = NoiseStream(seed)
        start(self.parameters, self.differentiation, self.state, self.chain, self.noise.row())
        return self.measurement()

    def step(self, valve_current: float) -> FloatArray:
        """Hold `valve_current` [A] for 1 ms; return the measurement x after it, shape (8,)."""
        advance(
            self.parameters, self.differentiation, self.state, self.chain, self.work, self.noise.row(), valve_current
        )
        return self.measurement()

    def run(self, currents: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Run many samples without a box, in one compiled loop.

        Parameters
        ----------
        currents
            Valve current [A] held over each sample, shape (n,).

        Returns
        -------
        After each sample: the measurement, shape (n, 8); it without noise, shape (n, 8); `TRUTH_FIELDS`, shape (n, 12).
        """
        count = len(currents)
        noisy, clean = np.empty((count, 8)), np.empty((count, 8))
        truth = np.empty((count, len(TRUTH_FIELDS)))
        records = (self.parameters, self.differentiation, self.state, self.chain, self.work)
        _run(*records, self.noise.rows(count), np.asarray(currents, np.float64), noisy, clean, truth)
        return noisy, clean, truth

    def measurement(self) -> FloatArray:
        """Present measurement x (eq. state_def), shape (8,), SI units; a copy."""
        return self.chain["measurement"][0].copy()

    def noise_free(self) -> FloatArray:
        """Present measurement without noise and quantisation, shape (8,); a copy."""
        return self.chain["clean"][0].copy()

    def physical(self) -> FloatArray:
        """Present physical quantities, shape (len(`TRUTH_FIELDS`),), a copy. The rates are those of the last 25 us."""
        row = np.empty(len(TRUTH_FIELDS))
        physical(self.state, row)
        return row
