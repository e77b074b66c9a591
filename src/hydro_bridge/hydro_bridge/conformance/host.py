# SPDX-License-Identifier: Apache-2.0
"""Host side of the line in a conformance test: sends the commands of a case and stores all answers of the box."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from hydro_bridge.errors import UserError
from hydro_bridge.serial.protocol import BoxLaw, Details, Hello, LawFrame, State, encode_command, encode_hello
from hydro_bridge.serial.stream import Decoder
from hydro_bridge.signals import Command, Law, ReferenceSignal, Waveform

_CIRCLE = 1 << 32
_PATIENCE = 1.0
"""s without a STATE after which a box counts as silent."""
_LOOK = 0.005
"""s, longest wait of one read of the line."""
PUNCTUAL = 0.015
"""s, longest interval between two reads with which this host is in time: a read ends whatever the box does."""


class Line(Protocol):
    """Byte transport: a `serial.port.Port`, or a box that is run in step."""

    def read(self, timeout: float) -> bytes:
        """Return the bytes received; none after `timeout` seconds."""

    def write(self, frame: bytes) -> bool:
        """Send bytes without waiting; return False if they were dropped."""


class SilentError(UserError):
    """The box sends no STATE."""


class UnreadableError(UserError):
    """Nothing received since the port was opened is a frame."""


@dataclass(frozen=True)
class Sent:
    """A command and its time of sending."""

    sequence: int
    command: Command
    after: int
    """Number of states received before."""


@dataclass
class Host:
    """One conversation with a box.

    Parameters
    ----------
    line
        Transport of the bytes.
    clock
        Returns seconds; the line's own clock where the box is run in step.
    """

    line: Line
    clock: Callable[[], float] = time.monotonic
    version: int = 1
    sequence: int = 0
    hello: Hello | None = None
    details: Details | None = None
    law: BoxLaw | None = None
    """The box's compensated law, if it offers one."""
    states: list[State] = field(default_factory=list)
    arrived: list[float] = field(default_factory=list)
    hellos: list[tuple[int, Hello]] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)
    command: Command = field(default_factory=Command)
    decoder: Decoder = field(default_factory=Decoder)
    marked: int = 0
    """Number of states received when the present step began."""
    marked_sent: int = 0
    greeted_at: int = 0
    lag: int = 0
    """Samples from a command to its confirming state, beyond the minimum; measured when the conversation begins."""
    silence: float = 0.0
    """s, longest time between two reads of the line, during which no command can have been sent."""
    looked: float | None = None
    notes: list[str] = field(default_factory=list)
    """Aspects that a passed check could not examine."""

    def mark(self) -> None:
        """Mark the beginning of a step: checks examine what is received from here on."""
        self.marked, self.marked_sent = len(self.states), len(self.sent)

    def forget(self) -> None:
        """Discard all but the newest state received before the conversation began: it may be of the previous one."""
        self.states, self.arrived = self.states[-1:], self.arrived[-1:]
        self.hellos, self.sent, self.silence = [], [], 0.0
        self.mark()

    def kept(self) -> Host:
        """Return a copy of the conversation so far, evaluated once it is over: the box does not wait."""
        states, arrived, hellos, sent = list(self.states), list(self.arrived), list(self.hellos), list(self.sent)
        return replace(self, states=states, arrived=arrived, hellos=hellos, sent=sent, notes=[])

    @property
    def new_states(self) -> list[State]:
        """States since the step began."""
        return self.states[self.marked :]

    @property
    def new_sent(self) -> list[Sent]:
        """Commands since the step began."""
        return self.sent[self.marked_sent :]

    def confirmed(self, sequence: int) -> int:
        """Return the index of the first state that confirms this command or a later one; the number of states if none.

        Only equal numbers confirm: the newest may be of the previous conversation, and larger.
        """
        first = next((n for n, each in enumerate(self.sent) if each.sequence == sequence), None)
        behind = {sequence} if first is None else {each.sequence for each in self.sent[first:]}
        begin = 0 if first is None else self.sent[first].after
        return next((n for n in range(begin, len(self.states)) if self.states[n].last_command in behind),
                    len(self.states))  # fmt: skip

    def greet(self) -> None:
        """Open a new conversation; the box's answer is stored when it arrives."""
        self.line.write(encode_hello(0, int(1e6 * self.clock())))

    def send(self, sequence: int | None = None, **changes: Any) -> None:
        """Send the last command with changes, under the next sequence number unless one is given."""
        self.command = changed(self.command, changes)
        self.sequence = (self.sequence + 1 if sequence is None else sequence) % _CIRCLE
        self.sent.append(Sent(self.sequence, self.command, len(self.states)))
        self.line.write(encode_command(self.sequence, int(1e6 * self.clock()), self.command, self.version))

    def write(self, data: bytes) -> None:
        """Send bytes as they are."""
        self.line.write(data)

    def listen(self, samples: int, each: Callable[[], None] | None = None) -> None:
        """Wait for a number of states, and call a function after each.

        Raises
        ------
        SilentError
            No state arrives for a second.
        UnreadableError
            No state arrives for a second, and no frame had arrived before.
        """
        wanted, last = len(self.states) + samples, self.clock()
        while len(self.states) < wanted:
            data = self.line.read(_LOOK)
            now = self.clock()
            self.silence = max(self.silence, now - (now if self.looked is None else self.looked))
            self.looked = now
            for frame in self.decoder.feed(data):
                if isinstance(frame, Hello) and frame.info is not None:
                    self.hello = frame
                    self.hellos.append((len(self.states), frame))
                elif isinstance(frame, Details):
                    self.details = frame
                elif isinstance(frame, LawFrame):
                    self.law = frame.record
                elif isinstance(frame, State):
                    self.states.append(frame)
                    self.arrived.append(self.clock())
                    last = self.clock()
                    if each is not None and len(self.states) <= wanted:
                        each()
            if self.clock() - last > _PATIENCE:
                self._give_up()

    def _give_up(self) -> None:
        counts = self.decoder.counts
        if counts.frames:
            raise SilentError(f"the box sent no STATE for {_PATIENCE:g} s")
        if not counts.bytes:
            raise UnreadableError(f"no byte came for {_PATIENCE:g} s: is the box on, and is this its port?")
        raise UnreadableError(
            f"{counts.bytes} bytes came and no frame in them: {counts.crc_errors} pieces with a wrong CRC, "
            f"{counts.malformed} malformed, {counts.wrong_version} of a version and {counts.unknown} of a type not "
            "known here; are the bit rate and the CRC right?"
        )


_SHAPE = ("amplitude", "offset", "frequency", "phase")


def changed(command: Command, changes: dict[str, Any]) -> Command:
    """Return a command with changes by name; those of the reference are in the same mapping, its waveform by name."""
    shape: dict[str, Any] = {name: float(changes[name]) for name in _SHAPE if name in changes}
    if "waveform" in changes:
        shape["waveform"] = Waveform[str(changes["waveform"]).upper()]
    names = ("delta_kp", "delta_ki", "delta_u", "velocity_compensation", "valve_gain_scale")
    rest: dict[str, Any] = {name: float(changes[name]) for name in names if name in changes}
    rest |= {name: bool(changes[name]) for name in ("arm", "filter_fresh") if name in changes}
    if "law" in changes:
        rest["law"] = Law[str(changes["law"]).upper()]
    if "coefficients" in changes:
        rest["coefficients"] = tuple(map(float, changes["coefficients"]))
    reference: ReferenceSignal = replace(command.reference, **shape)
    return replace(command, reference=reference, **rest)
