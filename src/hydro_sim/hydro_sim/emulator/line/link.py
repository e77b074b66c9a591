# SPDX-License-Identifier: Apache-2.0
"""The box's end of the serial line: states up, commands down, with fault injection. protocol.md."""

from __future__ import annotations

import numpy as np

from hydro_bridge.serial.protocol import encode_clock
from hydro_sim.box.box import Box
from hydro_sim.emulator.line.faults import FAULT_NAMES, FaultyLine, LinkFaults
from hydro_sim.emulator.line.host import HostState
from hydro_sim.emulator.line.terminal import Terminal


class BoxLink:
    """Serial line of the emulated box: the firmware's bytes through fault injection and terminal.

    `terminal`: the port. `box`: the box behind the line. `faults`: injected. `seed`: of their random numbers.
    """

    def __init__(self, terminal: Terminal, box: Box, faults: LinkFaults, seed: int = 0) -> None:
        self.terminal, self.box = terminal, box
        self.sent = self.unheard = self.blocked = 0
        """Frames sent as a whole; not sent as no host had the port open; not sent as the reader was too slow."""
        up, down = np.random.default_rng(seed).spawn(2)
        self.up, self.down = FaultyLine(faults, up), FaultyLine(faults, down)
        self._unwritten = b""
        self._replug_at = 0.0
        self.host, self._inbox, self._sent = HostState(), b"", b""
        self.waits: bool | None = None
        """Clock announced to hosts: whether each sample waits for the host's COMMAND; None: real time, no frame."""

    @property
    def faulty(self) -> bool:
        """Whether frames may be lost on this line."""
        return self.up.faulty or self.down.faulty

    @property
    def open(self) -> bool:
        """Whether a host has the port open, on a line that is not blocked."""
        return self.terminal.opened and self.up.stalled_until == 0.0

    def receive(self, now: float, patience: float = 0.0) -> None:
        """Read the bytes that arrive within `patience` s of wall clock, for the next `poll`; plug in when due."""
        if not self.terminal.plugged:
            if now < self._replug_at:
                return
            self.terminal.plug()
        if patience:
            self.terminal.wait(patience)
        if data := self.down.transmit(self.terminal.read(), now):
            self.host.observe(data)
            self._inbox += data

    def set_faults(self, faults: LinkFaults) -> None:
        """Replace the injected faults from now on."""
        self.up.faults = self.down.faults = faults

    def stall(self, seconds: float, now: float) -> None:
        """Block the line for `seconds` from `now` [s]."""
        for line in (self.up, self.down):
            line.stalled_until = max(line.stalled_until, now + seconds)

    def unplug(self, seconds: float, now: float) -> None:
        """Remove the port for `seconds` from `now` [s]."""
        self.terminal.unplug()
        self.up.clear()
        self.down.clear()
        self.host.reset()
        self._unwritten = self._inbox = b""
        self._replug_at = now + seconds

    def poll(self, now: float) -> None:
        """Pass the bytes that have arrived by `now` [s] to the box."""
        self.receive(now)
        if self._inbox:
            self.box.feed(self._inbox)
            self._inbox = b""

    def send(self, now: float) -> None:
        """Send the box's frames of its last sample, without blocking."""
        if not self.terminal.opened:
            self.unheard += 1
            self._unwritten = b""
            self.host.reset()
            return
        frames = self.box.frames()
        if self.host.fresh and self.waits is not None:
            frames = encode_clock(round(1e6 * now), waits=self.waits) + frames
        self._sent = frames
        self._write(self.up.transmit(frames, now))

    def resend(self, now: float) -> None:
        """Send the frames of the last sample again, after a repeated HELLO of the host."""
        self._write(self.up.transmit(self._sent, now))

    def _write(self, data: bytes) -> None:
        """A frame begun is finished before the next; a frame that finds the line full is dropped whole."""
        if self._unwritten:
            self._unwritten = self._unwritten[self.terminal.write(self._unwritten) :]
        if not data:
            return
        if self._unwritten:
            self.blocked += 1
            return
        self._unwritten = data[self.terminal.write(data) :]
        self.sent += 1

    def summary(self) -> str:
        """Return one line of text on the traffic and the injected faults."""
        taken, stale, greetings = (int(self.box.state[name][0]) for name in ("taken", "stale", "greetings"))
        made = {name: self.up.counts[name] + self.down.counts[name] for name in FAULT_NAMES}
        faults = ", ".join(f"{name} {count}" for name, count in made.items() if count)
        return (
            f"{self.sent} frames sent, {self.unheard} unheard, {self.blocked} blocked, "
            f"{taken} commands taken, {stale} refused as old or repeated, {greetings} connections"
        ) + (f"; faults made: {faults}" if faults else "")
