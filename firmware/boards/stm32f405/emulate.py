# SPDX-License-Identifier: Apache-2.0
"""Run a box on a core that QEMU emulates: `emulate.py out/box.elf --link core/port`.

Its two ports are named pipes beside the link. The second one leads to the converters of `emulator --analogue`, and the
first to the link, as a USB adapter does. QEMU hands over each byte by itself and is not in real time, so the end of a
conversion begins a sample: once the STATE of the one before has come, a host that answers each sample has answered it,
and not faster than --pace. The plant goes on alone only while the core is off: a busy machine makes all slower.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import random
import re
import secrets
import subprocess
import termios
import time
from array import array
from contextlib import closing, suppress
from pathlib import Path

from hydro_bridge.serial.protocol import State, encode_clock
from hydro_bridge.serial.stream import Decoder
from hydro_core.cli.console import bounded_number, command
from hydro_core.process import termination
from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.emulator.analogue import Converters, make_converters, obey_all
from hydro_sim.emulator.line.host import HostState
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.realtime import ControlPipe

MOMENT = 0.05  # s of wall clock
GATHERING = 2e-4  # s for which bytes gather, which QEMU gives one by one
ANSWER_TIME_MAX = 0.02  # s of wall clock that an answer is awaited on a line that loses bytes


class Pipe:
    """A port of the core: the named pipes `path`.in and `path`.out, which stay open while there is no core."""

    def __init__(self, path: Path) -> None:
        self.path, self._ends = path, []
        for end in (path.with_suffix(".out"), path.with_suffix(".in")):
            if not end.exists():
                os.mkfifo(end, 0o600)
            self._ends.append(os.open(end, os.O_RDWR | os.O_NONBLOCK))

    def fileno(self) -> int:
        """Descriptor that is ready when bytes have come."""
        return self._ends[0]

    def read(self, end: int = 0) -> bytes:
        """Return the bytes that have come; of end 1: that the core has not read."""
        with suppress(BlockingIOError):
            return os.read(self._ends[end], 65536)
        return b""

    def write(self, data: bytes) -> None:
        """Write what there is room for."""
        with suppress(BlockingIOError):
            os.write(self._ends[1], data)

    def unread(self) -> int:
        """Count the bytes that the core has not read yet."""
        return int(array("i", fcntl.ioctl(self._ends[1], termios.FIONREAD, bytes(4)))[0])


class Core:
    """QEMU with a program, switched on and off; `folder`: of its pipes, and of the monitor's socket `qmp`."""

    def __init__(self, program: Path, folder: Path, terminal: Terminal, seed: int) -> None:
        self.program, self.folder, self.terminal, self._random = program, folder, terminal, random.Random(seed)
        self.line, self.converters = Pipe(folder / "line"), Pipe(folder / "analogue")
        self.loss, self.host, self.process, self._decoder, self._up = 0.0, HostState(), None, Decoder(), b""
        self.told: int | None = None
        """Time [us] of this sample; None: its STATE has not come."""

    def switch(self, on: bool) -> None:
        """Switch it on, with nothing on its lines from before, or off, in the middle of whatever it does."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
        self.process = None
        if on:
            for end in (0, 1):
                self.line.read(end), self.converters.read(end)
            kept = subprocess.check_output(["arm-none-eabi-nm", self.program], text=True)
            place = next(line.split()[0] for line in kept.splitlines() if line.endswith(" kept"))
            self.process = subprocess.Popen(
                ["qemu-system-arm", "-M", "netduinoplus2", "-kernel", self.program, "-nographic", "-monitor", "none",
                 "-serial", f"pipe:{self.line.path}", "-serial", f"pipe:{self.converters.path}",
                 "-device", f"loader,addr=0x{place},data={secrets.randbits(32)},data-len=4",
                 "-qmp", f"unix:{self.folder / 'qmp'},server=on,wait=off"],
                stdout=subprocess.DEVNULL,
            )  # fmt: skip

    def carry(self, seconds: float) -> None:
        """Carry what has come between its line and the port, once there are bytes, or so many seconds have passed."""
        self.terminal.wait(seconds, self.line.fileno(), self.converters.fileno())
        time.sleep(GATHERING)
        up, down = self.line.read(), self._worn(self.terminal.read())
        for frame in self._decoder.feed(up):
            self.told = frame.time_us if isinstance(frame, State) else self.told
        whole, _, self._up = (self._up + up).rpartition(b"\0")
        if not self.terminal.opened:
            self.host.reset()
        elif whole:
            clock = encode_clock(self.told, waits=True) if self.host.fresh and self.told is not None else b""
            self.terminal.write(self._worn(clock + whole + b"\0"))
        self.host.observe(down)
        self.line.write(down)

    def is_done(self, waited: float) -> bool:
        """Whether the last sample has ended after so many s: it was told, the core has read all, a host answered."""
        answered = self.host.fresh or not self.host.lock_step or self.host.time_us == self.told
        done = self.told is not None and answered and not self.line.unread()
        return done or (self.loss > 0.0 and waited > ANSWER_TIME_MAX)

    def _worn(self, data: bytes) -> bytes:
        return bytes(byte for byte in data if self._random.random() >= self.loss) if self.loss else data


def run(core: Core, converters: Converters, control: ControlPipe | None, period: float, stop: list[int]) -> None:
    """Let the core's samples go, each `period` [s] or later, until stopped."""
    went, owed = time.monotonic(), b""

    def obey(order: str) -> None:
        nonlocal owed
        if order in ("on", "off"):
            core.switch(order == "on")
            owed = b""
        elif found := re.fullmatch(r"loss (0?\.\d+|[01])", order):
            core.loss = float(found[1])
        else:
            converters.obey(order)

    while not stop and (core.process is None or core.process.poll() is None):
        left = went + period - time.monotonic()
        if owed and core.line.unread():
            left = GATHERING  # nothing tells that it has read
        core.carry(min(left, MOMENT) if owed and left > 0.0 else MOMENT)
        owed += converters.exchange(core.converters.read())
        waited = time.monotonic() - went
        if owed and waited >= period and (converters.begins or core.is_done(waited)):
            core.converters.write(owed)
            went, owed, core.told = time.monotonic(), b"", None
        if core.process is None:
            converters.go_on()
        obey_all(control, obey)


@command(ValueError, OSError, subprocess.CalledProcessError)
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path, help="box.elf")
    parser.add_argument("--link", type=Path, required=True, metavar="PATH", help="where the port appears")
    parser.add_argument("--pace", type=bounded_number(0.01, 1.0), default=1.0, metavar="X",
                        help="at most so many times real time (default: 1; two cores reach a sixth)")  # fmt: skip
    parser.add_argument("--truth", metavar="FILE", help="of the plant (default: the default profile)")
    parser.add_argument("--bench", metavar="FILE", help="what the box believes (default: the nominal bench)")
    parser.add_argument("--seed", type=int, default=0, help="of noise and lost bytes")
    parser.add_argument("--control", type=Path, metavar="PATH", help="named pipe for orders: those of emulator "
                        "--analogue, on, off, loss 0.01 (the chance that a byte of the line is lost)")  # fmt: skip
    asked = parser.parse_args()
    asked.link.parent.mkdir(parents=True, exist_ok=True)
    converters = make_converters(asked.truth, asked.bench, asked.seed)
    orders = asked.control or asked.link.with_suffix(".control")
    with termination.signals_noted() as stop, closing(ControlPipe(orders)) as control:
        core = Core(asked.program, asked.link.parent, Terminal(asked.link), asked.seed)
        core.switch(on=True)
        print(f"port {asked.link}, an emulated core: --plant bench --port {asked.link}", flush=True)
        try:
            run(core, converters, control, SAMPLE_PERIOD / asked.pace, stop)
        finally:
            core.switch(on=False)
            core.terminal.unplug()
    print(f"{converters.conversions} samples, {converters.alone} without the core", flush=True)


if __name__ == "__main__":
    main()
