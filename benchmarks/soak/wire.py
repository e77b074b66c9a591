# SPDX-License-Identifier: Apache-2.0
"""The serial line with a stranger on it: whole frames pass both ways, and hostile bytes come between them.

Orders, to a process of its own::

    hostile N    so many hostile bytes a millisecond each way, on average, from now on
    replay N     so many old frames each way, at once
    mute N       nothing of the host's reaches the box for so many seconds
    unplug N     the bridge's port is gone for so many seconds
    report       answer by `Line.report`
"""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections import deque
from contextlib import ExitStack
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from hydro_bridge.serial.protocol import CommandFrame, MalformedError, State, decode
from hydro_core.signals import STATE_FIELDS
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.realtime import request_realtime
from tests.frames import DAMAGES

_TRACED = ("time", "sequence", "flags", "command", "force", "current", "kp")
TYPE = np.dtype(list(zip(_TRACED, ("f8", "u4", "u4", "u4", "f4", "f4", "f4"), strict=True)))
"""Of the trace: time [s, monotonic], sequence, flags, last command taken, load force [N], current [A], K_p [1/s]."""
_SHOWN = [STATE_FIELDS.index(name) for name in ("load_force", "valve_current", "proportional_gain")]
_KEPT = 500  # frames that may be sent again: fewer than the host remembers as seen
_HELD = 65536  # bytes for a line that nobody reads; the oldest are lost
_TICK = 5e-4  # s


class Direction:
    """One way of the line: frames that passed, and what a stranger makes of them.

    What is hostile is noise, damaged frames, frames of another version, and frames that have passed already. A HELLO is
    never sent again: that opens a conversation again, and the wire has no key (network.md).
    """

    def __init__(self, random: Random) -> None:
        self.frames = self.hostile = 0
        self.unwritten = b""
        self._random, self._rest = random, b""
        self._passed: deque[bytes] = deque(maxlen=_KEPT)
        self._owed = 0.0

    def whole(self, data: bytes) -> list[bytes]:
        """Frames that end within `data`, without delimiters."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        return [piece for piece in pieces if piece]

    def let_pass(self, piece: bytes, frame: object) -> None:
        """Send it on; what is no greeting may be sent again later."""
        wire = b"\0" + piece + b"\0"
        self.frames += 1
        self.unwritten += wire
        if isinstance(frame, State | CommandFrame):
            self._passed.append(wire)

    def disturb(self, size: float) -> None:
        """Send `size` hostile bytes, on average."""
        self._owed += size
        while self._owed > 0.0:
            chunk = self._chunk()
            self._owed -= max(len(chunk), 1)
            self.hostile += len(chunk)
            self.unwritten += chunk

    def replay(self, count: int) -> None:
        """Send frames again that have passed, in their order."""
        self.unwritten += b"".join(list(self._passed)[-count:])

    def written(self, count: int) -> None:
        """Forget the first `count` bytes; of a line that nobody reads, all but the last."""
        self.unwritten = self.unwritten[count:][-_HELD:]

    def _chunk(self) -> bytes:
        chance = self._random.random()
        if chance < 0.3 or not self._passed:
            return self._random.randbytes(self._random.randint(1, 64))
        wire = self._random.choice(self._passed)
        return wire if chance < 0.5 else self._random.choice(DAMAGES)(wire, self._random)


def start(stack: ExitStack, folder: Path, seed: int) -> Connection:
    """Carry in a process of its own that ends with `stack`; returns where it takes its orders.

    It carries between the box's port `folder`/box and `folder`/port, where the bridge finds its own, and writes
    `folder`/trace: a record (`TYPE`) of each of the box's states. `seed`: of all that is random.
    """
    (folder / "trace").touch()
    own = get_context("spawn")
    orders, theirs = own.Pipe()
    process = own.Process(target=carry, args=(theirs, folder, seed))
    process.start()
    stack.callback(process.kill)
    return orders


class Line:
    """Both ways."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._trace = (folder / "trace").open("ab", buffering=0)
        self.up, self.down = Direction(Random(seed)), Direction(Random(seed + 1))
        self.rate, self.muted_until, self._gone_until = 0.0, 0.0, 0.0
        self._box, self._port = folder / "box", -1
        self._terminal = Terminal(folder / "port")
        self._terminal.unplug()
        self._commands: deque[int] = deque(maxlen=4096)
        self._disturbed, self._forged = time.monotonic(), 0

    def report(self) -> dict[str, Any]:
        """Whole frames and hostile bytes that went `up` and `down`; `forged`: states that name a command never sent."""
        ways = {"up": self.up, "down": self.down}
        passed = {name: {"frames": way.frames, "hostile": way.hostile} for name, way in ways.items()}
        return {**passed, "forged": self._forged}

    def step(self) -> None:
        """Wait a moment for bytes, and carry them."""
        if self._port < 0:
            self._plug()
            return
        try:
            ready = select.select([self._port], [], [], _TICK)[0]
            data = os.read(self._port, 65536) if ready else b""
            if ready and not data:
                raise OSError("gone")
            now = time.monotonic()
            if not self._terminal.plugged and now >= self._gone_until:
                self._terminal.plug()
            self._carry(data, self._terminal.read(), now)
            with contextlib.suppress(BlockingIOError):
                self.down.written(os.write(self._port, self.down.unwritten))
            self.down.written(0)
        except OSError:  # the box has gone: so has the adapter
            os.close(self._port)
            self._port = -1
            self._terminal.unplug()
            return
        unread = len(self.up.unwritten)
        self.up.written(self._terminal.write(self.up.unwritten) if self._terminal.opened else unread)

    def unplug(self, seconds: float) -> None:
        """Take the bridge's port away for so long; the box goes on."""
        self._terminal.unplug()
        self._gone_until = time.monotonic() + seconds

    def _plug(self) -> None:
        try:
            self._port = os.open(self._box, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            time.sleep(0.02)
            return
        self.up.unwritten = self.down.unwritten = b""
        if time.monotonic() >= self._gone_until:
            self._terminal.plug()

    def _carry(self, up: bytes, down: bytes, now: float) -> None:
        for piece in self.down.whole(down):
            frame = _frame(piece)
            if now >= self.muted_until:
                self.down.let_pass(piece, frame)
                if isinstance(frame, CommandFrame):
                    self._commands.append(frame.sequence)
        for piece in self.up.whole(up):
            frame = _frame(piece)
            self.up.let_pass(piece, frame)
            if isinstance(frame, State):
                self._forged += frame.last_command > 0 and frame.last_command not in self._commands
                shown = (frame.values[place] for place in _SHOWN)
                record = (now, frame.sequence, frame.flags, frame.last_command, *shown)
                self._trace.write(np.array(record, TYPE).tobytes())
        size, self._disturbed = 1e3 * self.rate * (now - self._disturbed), now
        for way in (self.up, self.down):
            way.disturb(size)


def _frame(piece: bytes) -> object:
    try:
        return decode(piece)
    except MalformedError:
        return None


def carry(pipe: Connection, folder: Path, seed: int) -> None:
    """Carry until it is killed; a Ctrl-C of the terminal is none to this process."""
    os.setsid()
    line = Line(folder, seed)
    request_realtime()
    while True:
        line.step()
        if not pipe.poll():
            continue
        word, *numbers = pipe.recv().split()
        match word, *map(float, numbers):
            case ("report",):
                pipe.send(line.report())
            case "hostile", rate:
                line.rate = rate
            case "mute", seconds:
                line.muted_until = time.monotonic() + seconds
            case "unplug", seconds:
                line.unplug(seconds)
            case "replay", count:
                line.up.replay(int(count))
                line.down.replay(int(count))
