# SPDX-License-Identifier: Apache-2.0
"""The host's end of the line in a conformance test: it sends what it is told, and keeps all that the box sends."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from hydro_bridge.errors import UserError
from hydro_bridge.serial.protocol import Details, Hello, State, encode_command, encode_hello
from hydro_bridge.serial.stream import Decoder
from hydro_bridge.signals import Command, ReferenceSignal, Waveform

_CIRCLE = 1 << 32
_PATIENCE = 1.0
"""s without a STATE after which a box counts as silent."""


class Line(Protocol):
    """What carries the bytes: a `serial.port.Port`, or a box that is run in step."""

    def read(self, timeout: float) -> bytes:
        """What has come; nothing after `timeout` seconds."""

    def write(self, frame: bytes) -> bool:
        """Send bytes without waiting; False: dropped."""


class SilentError(UserError):
    """The box sends no STATE."""


@dataclass(frozen=True)
class Sent:
    """A command, and when it went out."""

    sequence: int
    command: Command
    after: int
    """Number of states that had come before."""


@dataclass
class Host:
    """One conversation with a box.

    Parameters
    ----------
    line
        Where the bytes go.
    clock
        Gives seconds; that of the line where it is run in step.
    """

    line: Line
    clock: Callable[[], float] = time.monotonic
    version: int = 1
    sequence: int = 0
    hello: Hello | None = None
    details: Details | None = None
    states: list[State] = field(default_factory=list)
    arrived: list[float] = field(default_factory=list)
    hellos: list[tuple[int, Hello]] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)
    command: Command = field(default_factory=Command)
    decoder: Decoder = field(default_factory=Decoder)
    marked: int = 0
    """States that had come when the present step began."""
    marked_sent: int = 0
    greeted_at: int = 0

    def mark(self) -> None:
        """A step begins: checks look at what comes from here on."""
        self.marked, self.marked_sent = len(self.states), len(self.sent)

    def forget(self) -> None:
        """Forget what came before the conversation stood: it may be of the one before. The newest state stays."""
        self.states, self.arrived = self.states[-1:], self.arrived[-1:]
        self.hellos, self.sent = [], []
        self.mark()

    @property
    def new_states(self) -> list[State]:
        """States since the step began."""
        return self.states[self.marked :]

    @property
    def new_sent(self) -> list[Sent]:
        """Commands since the step began."""
        return self.sent[self.marked_sent :]

    def confirmed(self, sequence: int) -> int:
        """Index of the first state that confirms this command or one behind it; the number of states if none does."""
        behind = (n for n, state in enumerate(self.states) if n >= self._sent_at(sequence) and not
                  (state.last_command - sequence) % _CIRCLE >= _CIRCLE // 2)  # fmt: skip
        return next(behind, len(self.states))

    def _sent_at(self, sequence: int) -> int:
        return next((each.after for each in self.sent if each.sequence == sequence), 0)

    def greet(self) -> None:
        """Open a new conversation; the box's answer is kept when it comes."""
        self.line.write(encode_hello(0, int(1e6 * self.clock())))

    def send(self, sequence: int | None = None, **changes: Any) -> None:
        """Send the last command with changes; its sequence is the next one if none is given."""
        self.command = changed(self.command, changes)
        self.sequence = (self.sequence + 1 if sequence is None else sequence) % _CIRCLE
        self.sent.append(Sent(self.sequence, self.command, len(self.states)))
        self.line.write(encode_command(self.sequence, int(1e6 * self.clock()), self.command, self.version))

    def write(self, data: bytes) -> None:
        """Send bytes as they are."""
        self.line.write(data)

    def listen(self, samples: int, each: Callable[[], None] | None = None) -> None:
        """Wait for so many states, and do something after each.

        Raises
        ------
        SilentError
            None comes for a second.
        """
        wanted, last = len(self.states) + samples, self.clock()
        while len(self.states) < wanted:
            for frame in self.decoder.feed(self.line.read(0.02)):
                if isinstance(frame, Hello) and frame.info is not None:
                    self.hello = frame
                    self.hellos.append((len(self.states), frame))
                elif isinstance(frame, Details):
                    self.details = frame
                elif isinstance(frame, State):
                    self.states.append(frame)
                    self.arrived.append(self.clock())
                    last = self.clock()
                    if each is not None and len(self.states) <= wanted:
                        each()
            if self.clock() - last > _PATIENCE:
                raise SilentError(f"the box sent no STATE for {_PATIENCE:g} s")


_SHAPE = ("amplitude", "offset", "frequency", "phase")


def changed(command: Command, changes: dict[str, Any]) -> Command:
    """A command with changes by name; those of the reference stand beside the others, its waveform by its name."""
    shape: dict[str, Any] = {name: float(changes[name]) for name in _SHAPE if name in changes}
    if "waveform" in changes:
        shape["waveform"] = Waveform[str(changes["waveform"]).upper()]
    names = ("delta_kp", "delta_ki", "delta_u")
    rest: dict[str, Any] = {name: float(changes[name]) for name in names if name in changes}
    rest |= {name: bool(changes[name]) for name in ("arm", "filter_fresh") if name in changes}
    reference: ReferenceSignal = replace(command.reference, **shape)
    return replace(command, reference=reference, **rest)
