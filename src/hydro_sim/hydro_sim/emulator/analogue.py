# SPDX-License-Identifier: Apache-2.0
"""The analogue side of a box on a microcontroller: converters of 16 bits between its core and the truth plant.

Frames on the second line of `firmware/boards/stm32f405`, counts little-endian, the last byte the sum of those before:

===== ========================================== ===============================================================
``5A`` n, current                                 starts a conversion; 32768 is 0 A, 32767 more the largest current
``A5`` n, f_h, f_l, p_a, p_b, x_p                 its readings: the middle of each range, 1.25 times it over 65535
===== ========================================== ===============================================================

The plant's time is the core's: each current is held for one sample. A core that is silent for `SILENCE_MAX` is off: the
plant goes on by itself, at 0 A. An emulated core begins a sample at the end of a conversion: `Adapter` gives it the
clock, real time or that of a host which answers each sample.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import random
import select
import struct
import sys
import termios
import time
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hydro_bridge.serial.port import Port, PortLostError
from hydro_bridge.serial.protocol import FrameType, encode_clock
from hydro_core.cli.console import bounded_number
from hydro_core.settings import SettingsError
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.line.host import HostState, observe
from hydro_sim.emulator.line.terminal import Terminal
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
_CONTROL_POLL = 20  # conversions between polls of the control pipe
_MOMENT = 0.05  # s of wall clock
_ANSWER_TIME_MAX, _ANSWER_TIME_MOST = 0.02, 90.0
"""s of wall clock that a host's answer is awaited, on a line that loses some, and on one that loses none."""
_GATHERING = 2e-4  # s for which bytes gather, which an emulated core gives one by one
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
        self._rest, self._counts = b"", np.zeros(5, np.uint16)

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
            self.begins = number == 0
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

    def run(
        self, port: Port | Pipes, adapter: Adapter | None, control: ControlPipe | None, seconds: float | None,
        stopped: Callable[[], bool],
    ) -> None:  # fmt: skip
        """Serve the core's port, and its line, until stopped or for so many s of its time; a port may be lost."""
        last, owed = time.monotonic(), b""
        while not stopped() and (seconds is None or self.conversions * SAMPLE_PERIOD < seconds):
            before = self.conversions
            try:
                if adapter is not None:
                    adapter.carry(owing=bool(owed))
                owed += self.exchange(port.read(0.0 if adapter else SILENCE_MAX))
                if owed and (adapter is None or adapter.lets_go(self.begins)):
                    port.write(owed)
                    owed, last = b"", time.monotonic()
            except PortLostError:
                self._reopen(port)
            now = time.monotonic()
            if self.conversions and not owed and now - last > SILENCE_MAX:  # until its first current it was never on
                for _ in range(round((now - last) / SAMPLE_PERIOD)):
                    self.plant.step(0.0)
                    self.alone += 1
                last = now
            if self.conversions // _CONTROL_POLL != before // _CONTROL_POLL or self.conversions == before:
                self._listen(control, adapter)

    def _reopen(self, port: Port | Pipes) -> None:
        time.sleep(0.02)
        try:
            port.open()
        except PortLostError:
            port.close()
        self._rest = b""

    def _listen(self, control: ControlPipe | None, adapter: Adapter | None) -> None:
        for order in control.lines() if control is not None else ():
            try:
                if adapter is not None and order.startswith("loss "):
                    adapter.loss = bounded_number(0.0, 1.0)(order[5:])
                else:
                    self.obey(order)
            except (SettingsError, argparse.ArgumentTypeError) as error:
                print(f"error: {error}", file=sys.stderr)


class Pipes:
    """A port of an emulated core: the named pipes `path`.in and `path`.out of QEMU's `-serial pipe:path`, made here."""

    def __init__(self, path: Path) -> None:
        self._ends = []
        for end in (path.with_name(f"{path.name}.out"), path.with_name(f"{path.name}.in")):
            if not end.exists():
                os.mkfifo(end, 0o600)
            self._ends.append(os.open(end, os.O_RDWR | os.O_NONBLOCK))  # stays open while no core has it

    def open(self) -> None:
        """Do nothing: pipes are not lost."""

    def fileno(self) -> int:
        """Descriptor that is ready when bytes have come."""
        return self._ends[0]

    def read(self, timeout: float) -> bytes:
        """Return the available bytes; none after `timeout` seconds."""
        ready, _, _ = select.select([self], [], [], timeout)
        return os.read(self._ends[0], 65536) if ready else b""

    def write(self, data: bytes) -> bool:
        """Write what there is room for."""
        with contextlib.suppress(BlockingIOError):
            return os.write(self._ends[1], data) == len(data)
        return False

    def unread(self) -> int:
        """Bytes that the core has not read yet."""
        return int(array("i", fcntl.ioctl(self._ends[1], termios.FIONREAD, bytes(4)))[0])

    def close(self) -> None:
        """Close both."""
        for end in self._ends:
            os.close(end)


class Adapter:
    """The line of an emulated core as a port for its host, what a USB adapter is to a board, and the core's clock.

    `line`, `converters`: the core's two ports. `terminal`: the host's. `pace`: times real time; None: at the answers of
    a host that answers each sample, else 1. `seed`: of the bytes that are lost.
    """

    def __init__(self, line: Pipes, converters: Pipes, terminal: Terminal, pace: float | None, seed: int = 0) -> None:
        self.line, self.converters, self.terminal, self.pace = line, converters, terminal, pace
        self._ends = line.fileno(), converters.fileno()
        self._random = random.Random(seed)
        self.loss = 0.0
        """Chance that a byte is lost, each way; the order `loss 0.01` sets it."""
        self.host, self._up, self._went = HostState(), b"", time.monotonic()
        self._state_us: int | None = None  # time of the sample of now; None: its STATE has not come

    def carry(self, *, owing: bool) -> None:
        """Carry what has come, once there are bytes, or a moment has passed; `owing`: an answer to it."""
        left = self._went + SAMPLE_PERIOD / (self.pace or 1.0) - time.monotonic()
        if owing and self.line.unread():
            left = _GATHERING  # nothing tells that the core has read
        self.terminal.wait(min(left, _MOMENT) if owing and left > 0.0 else _MOMENT, *self._ends)
        time.sleep(_GATHERING)
        *frames, self._up = (self._up + self.line.read(0.0)).split(b"\0")
        up, down = b"".join(frame + b"\0" for frame in frames), self.terminal.read()
        for frame in filter(None, frames):
            if (found := observe(frame)) and found[0] == FrameType.STATE:
                self._state_us = found[1]
        if not self.terminal.opened:
            self.host.reset()
        elif up:
            if self.host.fresh and self.pace is None and self._state_us is not None:
                up = encode_clock(self._state_us, waits=True) + up
            self.terminal.write(self._worn(up))
        if down := self._worn(down):
            self.host.observe(down)
            self.line.write(down)

    def lets_go(self, begins: bool) -> bool:
        """Whether the core's next sample is due; `begins`: there was none since its reset."""
        waited = time.monotonic() - self._went
        answers = self.pace is None and self.host.lock_step and not self.host.fresh
        if begins or waited > (_ANSWER_TIME_MAX if self.loss else _ANSWER_TIME_MOST):
            due = True
        elif self._state_us is None or self.line.unread():  # a byte that was sent before a sample is there before it
            due = False
        else:
            due = self.host.time_us == self._state_us if answers else waited >= SAMPLE_PERIOD / (self.pace or 1.0)
        if due:
            self._went, self._state_us = time.monotonic(), None
        return due

    def _worn(self, data: bytes) -> bytes:
        return bytes(byte for byte in data if self._random.random() >= self.loss) if self.loss else data
