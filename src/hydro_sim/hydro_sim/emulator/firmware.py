# SPDX-License-Identifier: Apache-2.0
"""The emulated bench with the box in C; Python only transports its bytes."""

from __future__ import annotations

from itertools import count

import numpy as np

from hydro_bridge.serial.protocol import VERSION, BoxInfo, LawState, encode_command
from hydro_bridge.signals import Command
from hydro_sim.box.box import EMULATED_BOX, BoxConfig
from hydro_sim.box.firmware import Firmware, Precision
from hydro_sim.emulator.line.faults import LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.model.bench import Bench


class FirmwareMachine(Machine):
    """A `Machine` whose box is the one in C; parameters as there, and the box's precision and epoch."""

    def __init__(
        self,
        config: TruthConfig,
        bench: Bench | None = None,
        box: BoxConfig | None = None,
        seed: int = 0,
        precision: Precision = "double",
        epoch: int = 1,
    ) -> None:
        super().__init__(config, bench, box, seed)
        self.firmware = Firmware(bench or Bench.nominal(), box, self.sensors, precision, epoch, EMULATED_BOX)
        self._sent = count(1)

    @property
    def refused(self) -> tuple[int, int]:
        """Numbers of values, and of references, that the box refused since its power-up."""
        counts = self.firmware.counts()
        return counts["refused"], counts["refused_references"]

    @property
    def law_state(self) -> LawState:
        """Force law as it acted in the last sample."""
        return self.firmware.law_state()

    def restart(self) -> None:
        """Power-cycle the box."""
        self.firmware.power_on()
        self._sent = count(1)
        self.samples = 0

    def receive(self, command: Command) -> None:
        """Process a command as a frame of the line: its numbers become float32."""
        self.firmware.take(encode_command(next(self._sent), 0, command, VERSION))

    def tick(self) -> np.void:
        """One sample, as `Machine.tick`."""
        parameters, differentiation, state, chain = self.records
        self.clean[:] = chain[0]["clean"]
        truth.physical(state, self.physical)
        record = self.firmware.tick(chain[0]["measurement"], self.time)
        noise, current = self.plant.noise.row(), float(record[0]["valve_current"])
        truth.advance(parameters, differentiation, state, chain, self.plant.work, noise, current)
        self.samples += 1
        sample: np.void = record[0]
        return sample


class FirmwareLink(BoxLink):
    """The serial line of the box in C; `info` is for reports only, the box speaks for itself."""

    def __init__(
        self, terminal: Terminal, firmware: Firmware, info: BoxInfo, faults: LinkFaults, seed: int = 0
    ) -> None:
        super().__init__(terminal, info, faults, seed)
        self.firmware = firmware

    def poll(self, now: float) -> Command | None:
        """Pass to the box what has arrived by `now` [s]; it processes its commands itself."""
        if data := self._arrived(now):
            self.firmware.take(data)
        return None

    def reboot(self) -> None:
        """Do nothing: the machine's restart powers the box on again."""

    def _frames(self, sample: np.void) -> bytes:
        counts = self.firmware.counts()
        self.report.commands, self.report.refused = counts["taken"], counts["stale"]
        self.report.hellos, self.last_command = counts["greetings"], counts["last_command"]
        return self.firmware.frames()
