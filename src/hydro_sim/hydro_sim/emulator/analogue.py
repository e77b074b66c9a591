# SPDX-License-Identifier: Apache-2.0
"""The analogue side of a box on a microcontroller: converters of 16 bits between its core and the truth plant.

Frames on the second line of `firmware/boards/stm32f405`, counts little-endian, the last byte the sum of those before:

===== ========================================== ===============================================================
``5A`` n, current                                 starts a conversion; 32768 is 0 A, 32767 more the largest current
``A5`` n, f_h, f_l, p_a, p_b, x_p                 its readings: the middle of each range, 1.25 times it over 65535
===== ========================================== ===============================================================

The plant's time is the core's: each current is held for one sample. A core that is silent for `SILENCE_MAX` is off: the
plant goes on by itself, at 0 A.
"""

from __future__ import annotations

import struct
import sys
import time
from collections.abc import Callable

import numpy as np

from hydro_bridge.serial.port import Port, PortLostError
from hydro_core.settings import SettingsError
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.offline import load_truth_config
from hydro_sim.emulator.realtime import ControlPipe
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import READINGS

FAULTS = ("stuck", "beyond", "lost")
"""What a converter can do: stand still, stand at the end of its range, send a frame with a wrong sum (all: one bus)."""
SILENCE_MAX = 0.5
"""s of wall clock without a current after which the core counts as switched off."""
_PLACES = [0, 2, 4, 5, 6]  # of the readings in a measurement
_SPAN = 1.25  # of a converter, in ranges of its reading
_ZERO = 32768  # count of 0 A


def checked(body: bytes) -> bytes:
    """Append the sum of its bytes to a frame."""
    return body + bytes((sum(body) & 0xFF,))


class Converters:
    """Five converters and the current output of a box, with the plant behind them.

    `plant`: the truth. `bench`, `box`: ranges of readings and current, as in the core's box_config.h.
    """

    def __init__(self, plant: TruthPlant, bench: Bench, box: BoxConfig) -> None:
        ranges = box.constants(bench)[0]
        low, high = ranges["low"][_PLACES], ranges["high"][_PLACES]
        self.plant, self.current_max = plant, bench.valve_current_max
        self.middle, self.step = 0.5 * (low + high), _SPAN * (high - low) / 65535.0
        self.faults: dict[str, str] = {}
        self.conversions, self.alone = 0, 0  # statistics: samples of the core, and without it
        self.begins = False
        """Whether the last current was the first one behind a reset."""
        self._rest, self._counts, self._last = b"", np.zeros(5, np.uint16), time.monotonic()

    def exchange(self, data: bytes) -> bytes:
        """Take bytes of the core; return those of the conversions that they start."""
        data, answers = self._rest + data, b""
        while (at := data.find(0x5A)) >= 0 and len(data) >= at + 5:
            frame, data = data[at : at + 5], data[at + 5 :]
            if checked(frame[:4]) != frame:
                data = frame[1:] + data
                continue
            _, number, count = struct.unpack("<BBH", frame[:4])
            measured = self.plant.step((count - _ZERO) / 32767.0 * self.current_max)
            self.conversions += 1
            self.begins, self._last = number == 0, time.monotonic()
            answer = checked(struct.pack("<BB5H", 0xA5, number, *self.convert(measured)))
            if "lost" in self.faults.values():
                answer = answer[:-1] + bytes((answer[-1] ^ 0xFF,))
            answers += answer
        self._rest = data if at < 0 else data[at:]
        return answers

    def convert(self, measured: FloatArray) -> list[int]:
        """Counts of the five converters of a measurement, shape (8,), with their faults."""
        exact = np.rint((measured[_PLACES] - self.middle) / self.step + 32767.5)
        counts = np.clip(exact, 0, 65535).astype(np.uint16)
        for n, name in enumerate(READINGS):
            if self.faults.get(name) == "stuck":
                counts[n] = self._counts[n]
            elif self.faults.get(name) == "beyond":
                counts[n] = 65535
        self._counts = counts
        return [int(count) for count in counts]

    def go_on(self) -> None:
        """Step the plant by itself for as long as a core that was on has been silent, if that is `SILENCE_MAX`."""
        silence = time.monotonic() - self._last
        if self.conversions and silence > SILENCE_MAX:
            self._rest, self._last = b"", time.monotonic()
            for _ in range(round(silence / SAMPLE_PERIOD)):
                self.plant.step(0.0)
                self.alone += 1

    def obey(self, order: str) -> None:
        """Take an order such as `stuck pressure_a`, `beyond load_force`, `lost position`, `clear`.

        Raises SettingsError if it is none.
        """
        fault, _, reading = order.strip().partition(" ")
        if fault == "clear" and not reading:
            self.faults.clear()
        elif fault in FAULTS and reading in READINGS:
            self.faults[reading] = fault
        else:
            known = f"{', '.join(FAULTS)} with one of {', '.join(READINGS)}; clear"
            raise SettingsError(f"order {order!r} is none of {known}")


def make_converters(truth: str | None, bench: str | None, seed: int) -> Converters:
    """Return converters with a plant behind them by the files of a truth and of a bench; None: the default ones."""
    believed = Bench.load(bench) if bench else Bench.nominal()
    plant = TruthPlant(load_truth_config(truth, believed), seed)
    plant.step(0.0)  # compiles
    plant.reset(seed)
    return Converters(plant, believed, BoxConfig().of_bench(believed))


def serve(
    converters: Converters, port: Port, control: ControlPipe | None, seconds: float | None, stopped: Callable[[], bool]
) -> None:
    """Serve a core's port until stopped, or for so many s of its time; a port that is lost is opened again."""
    while not stopped() and (seconds is None or converters.conversions * SAMPLE_PERIOD < seconds):
        try:
            port.write(converters.exchange(port.read(SILENCE_MAX)))
        except PortLostError:
            _reopen(port)
        converters.go_on()
        obey_all(control, converters.obey)


def _reopen(port: Port) -> None:
    time.sleep(0.02)
    try:
        port.open()
    except PortLostError:
        port.close()


def obey_all(control: ControlPipe | None, obey: Callable[[str], None]) -> None:
    """Take the orders that have come; what is none is told on stderr."""
    for order in control.lines() if control is not None else ():
        try:
            obey(order)
        except SettingsError as error:
            print(f"error: {error}", file=sys.stderr)
