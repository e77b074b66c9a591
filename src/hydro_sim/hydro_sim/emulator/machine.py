# SPDX-License-Identifier: Apache-2.0
"""`Machine`: box and truth plant together; both the real-time loop and the offline path run it.

Sample k: the box reads x_k at box time k ms and decides u_k; the plant holds u_k until sample k + 1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, STATE_DTYPE, Command, FloatArray, StateArray
from hydro_sim.box import firmware
from hydro_sim.box.box import EMULATED_BOX, Box, BoxConfig
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model.bench import Bench

_NO_COMMAND = np.array([-1])


class Machine:
    """An emulated bench with its box.

    `config`: the truth. `bench`: bench that the box's force law assumes; absent: the nominal one. `box`: its settings.
    `seed`: of noise and random force. `precision`: of the box's floating-point numbers. `epoch`: of its power-on.
    """

    def __init__(
        self, config: TruthConfig, bench: Bench | None = None, box: BoxConfig | None = None, seed: int = 0, *,
        precision: Precision = "double", epoch: int = 1,
    ) -> None:  # fmt: skip
        self._seed = seed
        self.plant = truth.TruthPlant(config, seed)
        self.box = Box(
            bench or Bench.nominal(), box, self.plant.sensors, name=EMULATED_BOX, epoch=epoch, precision=precision
        )
        self.physical: FloatArray = np.empty(len(truth.TRUTH_FIELDS))
        """`plant.TRUTH_FIELDS` of the last sample of `tick`."""
        self.samples = 0  # since the last power-up
        self._commands = np.zeros(1, firmware.STRUCTURES[precision].command)

    @property
    def time(self) -> float:
        """Box time [s] of the next sample."""
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
        """Run one sample; return its record of `STATE_DTYPE`."""
        states, _, physical = self.run(self._commands, _NO_COMMAND)
        self.physical = physical[0]
        record: np.void = states[0]
        return record

    def run(
        self, commands: npt.NDArray[np.void], which: npt.NDArray[np.int64]
    ) -> tuple[StateArray, FloatArray, FloatArray]:
        """Run many samples in one compiled loop, with at most one command before each.

        `commands`: records of hydro_command in the box's precision, shape (m,). `which`: index into them for each
        sample, shape (n,); negative: none.

        Returns samples of `STATE_DTYPE`, shape (n,); readings without noise, shape (n, 8); `plant.TRUTH_FIELDS`, shape
        (n, 12).
        """
        count = len(which)
        noise = self.plant.noise.rows(count)
        output = np.empty(count, STATE_DTYPE), np.empty((count, len(PLANT_FIELDS)))
        physical = np.empty((count, len(truth.TRUTH_FIELDS)))
        box = firmware.function_addresses(self.box.precision), self.box.settings, self.box.state
        _loop(box, self.plant.records, self.plant.work, noise, self.samples, commands, which, *output, physical)
        self.samples += count
        return *output, physical


@njit
def _loop(box, plant, scratch, noise, first, commands, which, states, clean, physical):
    """Advance box and plant in place; `physical` and `clean` are those that the box of the same row reads."""
    code, settings, memory = box
    parameters, differentiation, state, chain = plant
    for k in range(len(which)):
        time = (first + k) * SAMPLE_PERIOD
        if which[k] >= 0:
            firmware.receive(code.receive, memory, settings, commands[which[k] : which[k] + 1], time)
        copy_vector(clean[k], chain[0].clean)
        truth.copy_physical(state, physical[k])
        firmware.tick(code.tick, memory, settings, chain[0].measurement, time, states[k : k + 1])
        truth.advance_sample(parameters, differentiation, state, chain, scratch, noise[k], states[k].valve_current)
