# SPDX-License-Identifier: Apache-2.0
"""The emulated bench on its line, at the pace of its host or of the wall clock; commands by a pipe."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from hydro_core.process.realtime import limit_run_time
from hydro_core.settings import SettingsError
from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.emulator.line.faults import FAULT_NAMES, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS
from hydro_sim.files import load_force
from hydro_sim.timer import PeriodicTimer, disable_timer_slack

CONTROL_COMMANDS = (*FAULT_NAMES, "stall", "unplug", "clear", "reboot")


class ControlPipe:
    """Pipe of commands, one per line: a probability (`corrupt 0.01`), `stall 0.3`, `unplug 2`, `clear`, `reboot`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            os.mkfifo(path, 0o600)
        if not stat.S_ISFIFO(path.stat().st_mode):
            raise SettingsError(f"{path} exists and is not a named pipe: give another place with --control")
        self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)  # for writing too: no end of file between writers
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


def execute_command(order: str, machine: Machine, link: BoxLink, now: float) -> None:
    """Execute one command at time `now` [s]. Raises SettingsError if it is invalid."""
    word, *rest = order.split() or [""]
    try:
        (number,) = map(float, [*rest, "0"] if word in ("clear", "reboot") else rest)
    except ValueError:
        number = -1.0
    if word not in CONTROL_COMMANDS or not 0.0 <= number <= (1.0 if word in FAULT_NAMES else 1e6):
        known = ", ".join(CONTROL_COMMANDS)
        raise SettingsError(f"order {order!r} is none of {known}, with a chance within [0, 1] or a number of seconds")
    if word == "clear":
        link.set_faults(LinkFaults())
    elif word == "reboot":
        machine.restart()
    elif word == "stall":
        link.stall(number, now)
    elif word == "unplug":
        link.unplug(number, now)
    else:
        link.set_faults(replace(link.up.faults, **{word: number}))


_LOAD_FORCE_COLUMN = TRUTH_FIELDS.index("load_force")
_CONTROL_POLL_SAMPLES = 20  # samples between polls of the control pipe
_GREETING_TIME_MAX = 2.0  # s of wall clock from a port's opening
_CONTROL_POLL_PERIOD = 0.05  # s of wall clock between polls of the control pipe while the host is awaited
_ANSWER_TIME_MAX = 0.02  # s of wall clock after which an answer counts as lost, on a line that loses some
_CATCH_UP_TIME_MAX = 0.01  # s that an emulator whose time is its own catches up after a stall of its machine
SILENCE_MAX = 90.0
"""s of wall clock without a frame after which a host counts as dead; while its graph works it sends one a second."""


class RealtimeEmulator:
    """Emulated bench on its line, in real time or paced by its host.

    ======== ======================================================================================================
    pace     when the next sample follows
    ======== ======================================================================================================
    None     once the host has answered the last one by a COMMAND with its time. Before the first sample a host's
             greeting is awaited. Real time where there is no host, where it does not say that it answers, and once it
             has been silent for `SILENCE_MAX`
    number   that many times as fast as real time
    ======== ======================================================================================================

    `machine`, `link`: bench and line. `pace`: see above. `control`: pipe of commands. `load_force`: ring file of the
    true load forces.
    """

    def __init__(
        self, machine: Machine, link: BoxLink, pace: float | None, control: ControlPipe | None = None,
        load_force: load_force.Ring | None = None,
    ) -> None:  # fmt: skip
        self.machine, self.link, self.control, self.load_force = machine, link, control, load_force
        self.link.waits = None if pace == 1.0 else pace is None
        # Where time is its own, it goes on late after a stall: a burst of samples would leave a host no time to answer.
        catch_up = _CATCH_UP_TIME_MAX if pace is None else 0.1
        self.timer = PeriodicTimer(SAMPLE_PERIOD / (pace or 1.0), catch_up_max=catch_up)
        self.samples, self.cpu = 0, 0.0  # statistics; s of CPU
        self._waits, self._deserted = pace is None, False
        self._sent_us = 0

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Run for `seconds`, or until `stopped`."""
        count, cpu = None if seconds is None else round(seconds / SAMPLE_PERIOD), time.process_time()
        gc.collect()
        gc.disable()  # the loop makes no cycles, and a collection would cost a deadline
        try:
            opened = math.inf
            while self._waits and not self.link.host.hellos and not stopped():
                opened = min(opened, time.monotonic()) if self.link.open else math.inf
                if time.monotonic() - opened > _GREETING_TIME_MAX:  # a host that does not greet
                    break
                self._obey(0.0)
                self.link.receive(0.0, _CONTROL_POLL_PERIOD)
            self.timer.restart()
            while (count is None or self.samples < count) and not stopped():
                now = self.samples * SAMPLE_PERIOD
                if self.samples % _CONTROL_POLL_SAMPLES == 0:
                    self._obey(now)
                self.link.poll(now)
                self._deserted = self._deserted and self.link.host.time_us != self._sent_us
                sample = self.machine.tick()
                if self.load_force is not None:
                    force = float(self.machine.physical[_LOAD_FORCE_COLUMN])
                    load_force.write_force(self.load_force, int(sample["sequence"]), force)
                self.link.send(now)
                self._sent_us = round(1e6 * float(sample["time"]))
                self.samples += 1
                if self._waits and self._answered(stopped):
                    self.timer.restart()
                else:
                    self.timer.wait()
        finally:
            gc.enable()
        self.cpu = time.process_time() - cpu

    def _answered(self, stopped: Callable[[], bool]) -> bool:
        """Wait for the host's answer to the last sample; False: there is no host that answers samples."""
        link, host, now = self.link, self.link.host, self.samples * SAMPLE_PERIOD
        hellos, greeted, began = host.hellos, host.fresh, time.monotonic()
        while not stopped():
            if not link.open:
                return False
            if host.time_us == self._sent_us and host.lock_step:
                self._deserted = False
                return True
            if host.hellos > hellos and not greeted:
                return True
            if host.hellos > hellos:  # greeted again before the answer came, which is in the last sample's frames
                hellos = host.hellos
                link.resend(now)
            if self._deserted or not host.lock_step:
                return False
            waited = time.monotonic() - began
            if link.faulty and waited > _ANSWER_TIME_MAX:
                return True
            if time.monotonic() - max(began, host.last_frame_time) > SILENCE_MAX:
                self._deserted = True
                print(f"no answer of the host for {SILENCE_MAX:g} s: going on in real time", flush=True)
            link.receive(now, _CONTROL_POLL_PERIOD if not link.faulty else _ANSWER_TIME_MAX)
            if waited > _CONTROL_POLL_PERIOD:
                self._obey(now)
        return True

    def _obey(self, now: float) -> None:
        for order in self.control.lines() if self.control is not None else ():
            try:
                execute_command(order, self.machine, self.link, now)
            except SettingsError as error:
                print(f"error: {error}", file=sys.stderr)


def request_realtime() -> str:
    """Request SCHED_FIFO and exact timers from the kernel; return a message on what was granted."""
    disable_timer_slack()
    try:
        limit_run_time()
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
        return "SCHED_FIFO 40"
    except (OSError, AttributeError):
        pass
    with contextlib.suppress(OSError):
        return f"nice {os.nice(-10)}"
    return "normal priority (no permission for more)"
