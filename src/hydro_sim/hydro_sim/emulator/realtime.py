# SPDX-License-Identifier: Apache-2.0
"""The emulated bench in real time: one sample per millisecond against absolute deadlines, and orders by a pipe."""

from __future__ import annotations

import contextlib
import gc
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from hydro_bridge.process.realtime import Pacer, exact_timers, limit_run
from hydro_bridge.settings import SettingsError
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.emulator.line.faults import CHANCES, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS
from hydro_sim.files import load_force

ORDERS = (*CHANCES, "stall", "unplug", "clear", "reboot")


class ControlPipe:
    """Commands, one per line: a probability (`corrupt 0.01`), `stall 0.3`, `unplug 2`, `clear`, `reboot`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if not path.exists():
                os.mkfifo(path, 0o600)
            if not stat.S_ISFIFO(path.stat().st_mode):
                raise SettingsError(f"{path} exists and is not a named pipe: give another place with --control")
            self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)  # for writing too: no end of file between writers
        except OSError as error:
            raise SettingsError(f"{path} cannot be made: {os.strerror(error.errno or 0).lower()}") from error
        self._rest = b""

    def lines(self) -> Iterator[str]:
        """Return the complete lines that have arrived."""
        with contextlib.suppress(BlockingIOError):
            self._rest = (self._rest + os.read(self._file, 4096))[-8192:]
        *lines, self._rest = self._rest.split(b"\n")
        for line in lines:
            yield line.decode(errors="replace")

    def close(self) -> None:
        """Remove the pipe."""
        os.close(self._file)
        with contextlib.suppress(OSError):
            self.path.unlink()


def execute(order: str, machine: Machine, link: BoxLink, now: float) -> None:
    """Execute one command at time `now` [s]. Raises SettingsError if it is not an order."""
    word, *rest = order.split() or [""]
    if word not in ORDERS or len(rest) != (0 if word in ("clear", "reboot") else 1):
        raise SettingsError(f"order {order!r} is none of: {', '.join(ORDERS)}; all but clear and reboot take a number")
    number = _number(rest[0]) if rest else 0.0
    if word == "clear":
        link.set_faults(LinkFaults())
    elif word == "reboot":
        machine.restart()
    elif word == "stall":
        link.stall(number, now)
    elif word == "unplug":
        link.unplug(number, now)
    elif number > 1.0:
        raise SettingsError(f"order {order!r}: a chance is within [0, 1]")
    else:
        link.set_faults(replace(link.up.faults, **{word: number}))


def _number(text: str) -> float:
    with contextlib.suppress(ValueError):
        number = float(text)
        if 0.0 <= number < 1e6:
            return number
    raise SettingsError(f"order: {text!r} is not a number of 0 or more")


_LOAD_FORCE = TRUTH_FIELDS.index("load_force")
_CONTROL_EVERY = 20  # samples between looks at the control pipe


@dataclass
class RealTime:
    """The running emulator."""

    machine: Machine
    link: BoxLink
    control: ControlPipe | None = None
    load_force: load_force.Ring | None = None

    def __post_init__(self) -> None:
        self.pacer, self.samples, self.cpu = Pacer(SAMPLE_PERIOD), 0, 0.0  # statistics; s of CPU

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Run for `seconds`, or until `stopped`."""
        count, cpu = None if seconds is None else round(seconds / SAMPLE_PERIOD), time.process_time()
        gc.collect()
        gc.disable()  # the loop makes no cycles, and a collection would cost a deadline
        try:
            self.pacer.restart()
            while (count is None or self.samples < count) and not stopped():
                self._sample(self.samples * SAMPLE_PERIOD)
                self.samples += 1
                self.pacer.wait()
        finally:
            gc.enable()
        self.cpu = time.process_time() - cpu

    def _sample(self, now: float) -> None:
        if self.control is not None and self.samples % _CONTROL_EVERY == 0:
            self._obey(now)
        self.link.poll(now)
        sample = self.machine.tick()
        if self.load_force is not None:
            load_force.keep(self.load_force, int(sample["sequence"]), float(self.machine.physical[_LOAD_FORCE]))
        self.link.send(now)

    def _obey(self, now: float) -> None:
        assert self.control is not None
        for order in self.control.lines():
            try:
                execute(order, self.machine, self.link, now)
            except SettingsError as error:
                print(f"error: {error}", file=sys.stderr)


def raise_priority() -> str:
    """Ask the kernel for real-time scheduling and exact timers; returns a sentence on what was granted."""
    exact_timers()
    try:
        limit_run()
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
        return "SCHED_FIFO 40"
    except (OSError, AttributeError):
        pass
    with contextlib.suppress(OSError):
        return f"nice {os.nice(-10)}"
    return "normal priority (no permission for more)"
