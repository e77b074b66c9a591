# SPDX-License-Identifier: Apache-2.0
"""The box's end of the serial line: states up, commands down, with fault injection. protocol.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hydro_bridge.serial.protocol import (
    VERSION,
    VERSION_MIN,
    BoxDetails,
    BoxInfo,
    BoxLaw,
    CommandFrame,
    Frame,
    Hello,
    LawState,
    encode_clock,
    encode_details,
    encode_hello,
    encode_law,
    encode_state,
)
from hydro_bridge.serial.stream import Decoder
from hydro_bridge.signals import NEUTRAL, Command, Law
from hydro_sim.emulator.line.faults import CHANCES, FaultyLine, LinkFaults
from hydro_sim.emulator.line.host import Host
from hydro_sim.emulator.line.terminal import Terminal

_CIRCLE = 1 << 32  # sequence numbers


@dataclass
class LinkReport:
    """Statistics of the box's link."""

    sent: int = 0  # frames that went out whole
    unheard: int = 0  # frames made while nobody had the port open
    blocked: int = 0  # frames dropped because the reader was too slow
    commands: int = 0  # commands taken
    refused: int = 0  # commands whose sequence number is old or was there already
    hellos: int = 0  # connections opened by a host


class BoxLink:
    """Serial line of the emulated box.

    Parameters
    ----------
    terminal
        The port.
    info
        Identity that the box states.
    faults, seed
        Injected faults, and the seed of their probabilities.
    details
        Additional data for a host of version 2 or more; its epoch counts up at each reboot.
    refused
        Returns how many values and references the box refused since its power-on.
    law
        Compensated law that the box offers, as `details.laws` says; told to a host of version 3.
    law_state
        Returns the force law as it acts, for a host of version 3.
    """

    def __init__(
        self,
        terminal: Terminal,
        info: BoxInfo,
        faults: LinkFaults,
        seed: int = 0,
        details: BoxDetails | None = None,
        refused: Callable[[], tuple[int, int]] = lambda: (0, 0),
        law: BoxLaw | None = None,
        law_state: Callable[[], LawState] = lambda: LawState(Law.PAPER, 0.0, 0.0, NEUTRAL, 1.0, 1.0),
    ) -> None:
        self.terminal = terminal
        self.info, self.details = info, details or BoxDetails(epoch=1)
        self.version = VERSION_MIN
        self._refused, self._law, self._law_state = refused, law, law_state
        self.report = LinkReport()
        self.decoder = Decoder()
        up, down = np.random.default_rng(seed).spawn(2)
        self.up, self.down = FaultyLine(faults, up), FaultyLine(faults, down)
        self.last_command = 0
        self._newest: int | None = None
        """Sequence number of the connection's last command; its first one may have any."""
        self._waiting: list[Frame] = []
        self._hellos = 0
        self._unwritten = b""
        self._replug_at = 0.0
        self._greeting = True
        self.host, self._inbox, self._sent = Host(), b"", b""
        self.waits: bool | None = None
        """What a host is told of this clock: whether each sample waits for its COMMAND; None: it is real time."""

    @property
    def faulty(self) -> bool:
        """Whether frames may be lost on this line."""
        return self.up.faulty or self.down.faulty

    @property
    def open(self) -> bool:
        """Whether a host has the port open, on a line that is not blocked."""
        return self.terminal.opened and not self.up.stalled

    def receive(self, now: float, patience: float = 0.0) -> None:
        """Take in what arrives within `patience` s of wall clock, for the next `poll`; plug in again when it is time."""
        if not self.terminal.plugged:
            if now < self._replug_at:
                return
            self.terminal.plug()
        if patience:
            self.terminal.wait(patience)
        if data := self.down.carry(self.terminal.read(), now):
            self.host.hear(data)
            self._inbox += data

    def set_faults(self, faults: LinkFaults) -> None:
        """Replace the injected faults from now on."""
        self.up.faults = self.down.faults = faults

    def stall(self, seconds: float, now: float) -> None:
        """Block the line for `seconds` from `now` [s]."""
        self.up.stall(now + seconds)
        self.down.stall(now + seconds)

    def unplug(self, seconds: float, now: float) -> None:
        """Remove the port for `seconds` from `now` [s]."""
        self.terminal.unplug()
        self.up.clear()
        self.down.clear()
        self.decoder.reset()
        self._waiting.clear()
        self.host.reset()
        self._unwritten = self._inbox = b""
        self._replug_at = now + seconds

    def reboot(self) -> None:
        """Reset after a power cycle: the box greets again, has no command, and loses any partial one."""
        self.last_command = 0
        self.decoder.reset()
        self._waiting.clear()
        self._newest = None
        self.details = replace(self.details, epoch=self.details.epoch % 0xFFFFFFFF + 1)
        self.version, self._hellos = VERSION_MIN, 0
        self._greeting = True

    def poll(self, now: float) -> Command | None:
        """Return the newest command that has arrived by `now` [s], if any; answer greetings, which disarm.

        What follows a greeting in the same millisecond waits for the next: the disarm must not be overtaken. A further
        greeting discards it: nothing accumulates, however many come.
        """
        data = self._arrived(now)
        frames, self._waiting = [*self._waiting, *(self.decoder.feed(data) if data else ())], []
        newest, greeted = None, False
        for frame in frames:
            if isinstance(frame, Hello) and frame.info is None:
                self._newest = None
                self._greeting = greeted = True
                self.version = max(VERSION_MIN, min(VERSION, frame.version_max))
                self._hellos = max(self._hellos, 1)  # an answer, no power-on
                self._waiting.clear()
                self.report.hellos += 1
            elif isinstance(frame, CommandFrame) and greeted:
                self._waiting.append(frame)
            elif isinstance(frame, CommandFrame) and self._is_newer(frame.sequence):
                newest, self.last_command, self._newest = frame.command, frame.sequence, frame.sequence
                self.report.commands += 1
            elif isinstance(frame, CommandFrame):
                self.report.refused += 1
        return Command() if greeted else newest

    def _is_newer(self, sequence: int) -> bool:
        """Return whether a sequence number is newer than all before (protocol.md, Order of commands; RFC 1982)."""
        return self._newest is None or 0 < (sequence - self._newest) % _CIRCLE < _CIRCLE // 2

    def _arrived(self, now: float) -> bytes:
        """Return bytes that have arrived by `now` [s]; plug in again when it is time."""
        self.receive(now)
        data, self._inbox = self._inbox, b""
        return data

    def send(self, sample: np.void, now: float) -> None:
        """Send one sample, a record of `STATE_DTYPE`, without ever waiting."""
        if not self.terminal.opened:
            self.report.unheard += 1
            self._unwritten = b""
            self.host.reset()
            return
        frames = self._frames(sample)
        if self.host.fresh and self.waits is not None:
            frames = encode_clock(round(1e6 * float(sample["time"])), waits=self.waits) + frames
        self._sent = frames
        self._write(self.up.carry(frames, now))

    def send_again(self, now: float) -> None:
        """Send the frames of the last sample again: its host greeted once more before it said anything else."""
        self._write(self.up.carry(self._sent, now))

    def _frames(self, sample: np.void) -> bytes:
        """Return the frames sent with this sample."""
        box_time, sequence, *values, flags = sample.item()
        time_us = round(box_time * 1e6)
        refused = self._refused() if self.version > VERSION_MIN else None
        law_state = self._law_state() if self.version > 2 else None
        frame = encode_state(sequence, time_us, values, flags, self.last_command, refused, law_state)
        if self._greeting:
            if self.version > 2 and self._law:
                frame = encode_law(self._hellos, time_us, self._law) + frame
            if self.version > VERSION_MIN:
                frame = encode_details(self._hellos, time_us, self.details, self.version) + frame
            frame = encode_hello(self._hellos, time_us, self.info) + frame
            self._hellos += 1
            self._greeting = False
        return frame

    def _write(self, data: bytes) -> None:
        """A frame begun is finished before the next; a frame that finds the line full is dropped whole."""
        if self._unwritten:
            self._unwritten = self._unwritten[self.terminal.write(self._unwritten) :]
        if not data:
            return
        if self._unwritten:
            self.report.blocked += 1
            return
        self._unwritten = data[self.terminal.write(data) :]
        self.report.sent += 1

    def summary(self) -> str:
        """Return one line of text on the traffic and the injected faults."""
        made = {name: self.up.counts[name] + self.down.counts[name] for name in CHANCES}
        text = (
            f"{self.report.sent} frames sent, {self.report.unheard} unheard, {self.report.blocked} blocked, "
            f"{self.report.commands} commands taken, {self.report.refused} refused as old or repeated, "
            f"{self.report.hellos} connections"
        )
        faults = ", ".join(f"{name} {count}" for name, count in made.items() if count)
        return text + (f"; faults made: {faults}" if faults else "")
