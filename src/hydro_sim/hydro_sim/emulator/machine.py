# SPDX-License-Identifier: Apache-2.0
"""`Machine`: box and truth plant together, one sample at a time; both the real-time loop and the offline path run it.

Sample k: the box reads x_k at box time k ms and decides u_k; the plant holds u_k until sample k + 1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, STATE_DTYPE, Command, FloatArray, StateArray
from hydro_sim.box import firmware
from hydro_sim.box.box import EMULATED_BOX, Box, BoxConfig, law_state
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model.bench import Bench


@njit
def step_box_and_plant(code, settings, box, plant, scratch, noise, time, sample, clean, physical):
    """Advance box and plant by one sample, in place.

    Parameters
    ----------
    code, settings, box
        Addresses of the firmware's calls, and its records of shape (1,): configuration and state.
    plant
        Tuple of the plant's records, shape (1,) each: parameters, differentiation, state, sensors.
    scratch
        Work space of the plant, shape (3, 8).
    noise
        Standard normal numbers for the reading after this sample, shape (`plant.NOISE_COLUMNS`,).
    time
        Box time [s] of this sample.
    sample
        Output: record of `STATE_DTYPE`, shape (1,).
    clean, physical
        Outputs: the reading without noise, shape (8,); `plant.TRUTH_FIELDS`, shape (12,). Both at `time`.
    """
    parameters, differentiation, state, chain = plant
    copy_vector(clean, chain[0].clean)
    truth.copy_physical(state, physical)
    firmware.tick(code.tick, box, settings, chain[0].measurement, time, sample)
    truth.advance_sample(parameters, differentiation, state, chain, scratch, noise, sample[0].valve_current)


class Machine:
    """An emulated bench with its box.

    Parameters
    ----------
    config
        The truth.
    bench
        What the box believes; absent: the nominal bench.
    box
        Settings of the box.
    seed
        Of noise and random force.
    precision, epoch
        Of the box's numbers, and of its power-on.
    """

    def __init__(
        self,
        config: TruthConfig,
        bench: Bench | None = None,
        box: BoxConfig | None = None,
        seed: int = 0,
        *,
        precision: Precision = "double",
        epoch: int = 1,
    ) -> None:
        self._seed = seed
        self.plant = truth.TruthPlant(config, seed)
        self.records = (self.plant.parameters, self.plant.differentiation, self.plant.state, self.plant.chain)
        self.sensors = self.plant.sensors
        believed = bench or Bench.nominal()
        self.box = Box(believed, box, self.sensors, name=EMULATED_BOX, epoch=epoch, precision=precision)
        self.clean, self.physical = np.empty(len(PLANT_FIELDS)), np.empty(len(truth.TRUTH_FIELDS))
        self.samples = 0  # since the last power-up

    @property
    def refused(self) -> tuple[int, int]:
        """Numbers of values, and of references, that the box refused since its power-up."""
        return self.box.refused

    @property
    def law_state(self) -> LawState:
        """State of the force law in the last sample."""
        return law_state(self.box.state[0])

    @property
    def time(self) -> float:
        """Box time [s] of the coming sample."""
        return self.samples * SAMPLE_PERIOD

    def warm_up(self) -> None:
        """Compile all kernels by one sample, then reset."""
        self.receive(Command())
        self.tick()
        self.plant.reset(self._seed)
        self.restart()

    def restart(self) -> None:
        """Power-cycle the box: disarmed, sequence and clock from zero, next epoch. The plant's state is kept."""
        self.box.reset()
        self.samples = 0

    def receive(self, command: Command) -> None:
        """Process a command that arrived since the last sample."""
        self.box.receive(command, self.time)

    def tick(self) -> np.void:
        """Run one sample; return its record of `STATE_DTYPE`. Sets `clean` and `physical` of this sample."""
        sample: StateArray = np.empty(1, STATE_DTYPE)
        box, plant, code = self.box, self.plant, firmware.function_addresses(self.box.precision)
        place = (self.time, sample, self.clean, self.physical)
        step_box_and_plant(code, box.settings, box.state, self.records, plant.work, plant.noise.row(), *place)
        self.samples += 1
        record: np.void = sample[0]
        return record

    def run(
        self, commands: npt.NDArray[np.void], which: npt.NDArray[np.int64]
    ) -> tuple[StateArray, FloatArray, FloatArray]:
        """Run many samples in one compiled loop, with a command before each.

        Parameters
        ----------
        commands
            Records of hydro_command in the box's precision, shape (m,).
        which
            Index into `commands` for each sample, shape (n,).

        Returns
        -------
        Samples of `STATE_DTYPE`, shape (n,); readings without noise, shape (n, 8); `plant.TRUTH_FIELDS`, shape (n, 12).
        """
        count = len(which)
        states = np.empty(count, STATE_DTYPE)
        clean, physical = np.empty((count, len(PLANT_FIELDS))), np.empty((count, len(truth.TRUTH_FIELDS)))
        noise = self.plant.noise.rows(count)
        box = (firmware.function_addresses(self.box.precision), self.box.settings, self.box.state)
        _run(box, self.records, self.plant.work, noise, self.samples, commands, which, states, clean, physical)
        self.samples += count
        return states, clean, physical


@njit
def _run(box, plant, scratch, noise, first, commands, which, states, clean, physical):
    code, settings, memory = box
    for k in range(len(which)):
        time = (first + k) * SAMPLE_PERIOD
        firmware.receive(code.receive, memory, settings, commands[which[k] : which[k] + 1], time)
        step_box_and_plant(
            code, settings, memory, plant, scratch, noise[k], time, states[k : k + 1], clean[k], physical[k]
        )
