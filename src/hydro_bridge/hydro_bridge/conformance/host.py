# SPDX-License-Identifier: Apache-2.0
"""Host side of the line in a conformance test: sends the commands of a case and stores all answers of the box.

A session opens with HELLO and a confirmed safe command, and ends disarmed. Each step of a case between these has a
handler in `STEP_HANDLERS`; some handlers send damaged frames or noise.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from random import Random
from typing import Any

from cobs import cobs

from hydro_bridge.serial import protocol
from hydro_bridge.serial.port import Port
from hydro_bridge.serial.stream import Decoder, LinkCounts, no_frames_message
from hydro_core.errors import UserError
from hydro_core.signals import Command, Law, Waveform

_SEQUENCE_MODULUS = 1 << 32
_SILENCE_MAX = 1.0
"""s without a STATE after which a box counts as silent."""
_READ_TIME_MAX = 0.005
"""s, longest wait of one read of the line."""
READ_INTERVAL_MAX = 0.015
"""s, longest interval between two reads of a host that is in time: a read ends whatever the box does."""


class NoStateError(UserError):
    """The box sends no STATE."""


class NoFrameError(UserError):
    """No valid frame has arrived since the port was opened."""


@dataclass(frozen=True)
class SentCommand:
    """Sent command, with its place among the received states."""

    sequence: int
    command: Command
    after: int
    """Number of states received before."""


@dataclass
class Host:
    """One session with a box: commands sent, states received.

    `line`: a port, or a box that is run in lock-step. `clock`: returns seconds; the line's own clock of such a box.
    """

    line: Port
    clock: Callable[[], float] = time.monotonic
    bench: Mapping[str, Any] = field(default_factory=dict)
    """Bench parameters assumed by the box's force law; empty: unknown."""
    sequence: int = 0
    info: protocol.BoxInfo = field(default_factory=protocol.BoxInfo)
    """Content of the box's last HELLO."""
    details: protocol.BoxDetails = field(default_factory=protocol.BoxDetails)
    law: protocol.BoxLaw | None = None
    """The box's compensated law, if it offers one."""
    states: list[protocol.State] = field(default_factory=list)
    arrival_times: list[float] = field(default_factory=list)
    emulated: bool = False
    """Whether the box is an emulator whose time is not the host's: it sent CLOCK, over a pseudo-terminal."""
    hellos: list[tuple[int, protocol.Hello]] = field(default_factory=list)
    """HELLOs of the box, each with the number of states received before."""
    sent: list[SentCommand] = field(default_factory=list)
    command: Command = field(default_factory=Command)
    decoder: Decoder = field(default_factory=Decoder)
    step_first_state: int = 0
    """Index of the first state of the present step."""
    step_first_command: int = 0
    """Index of the first command of the present step."""
    hello_index: int = 0
    """Number of states received when HELLO was last sent in a case."""
    lag: int = 0
    """Delay [samples] of a command's confirmation beyond the minimum; measured when the session begins."""
    longest_read_gap: float = 0.0
    """Longest interval [s] between two reads of the line, during which no command can have been sent."""
    last_read: float | None = None
    correction_scale: float = 1.0
    """Factor on the cases' delta_u, so that the motion is no larger, in proportion, than the nominal bench's."""
    notes: list[str] = field(default_factory=list)
    """Aspects that a passed check could not examine."""

    def begin_step(self) -> None:
        """Begin a step of a case: checks examine the states received from here on."""
        self.step_first_state, self.step_first_command = len(self.states), len(self.sent)

    def snapshot(self) -> Host:
        """Return a copy of the session so far, for evaluation after the case."""
        states, arrived, hellos, sent = list(self.states), list(self.arrival_times), list(self.hellos), list(self.sent)
        return replace(self, states=states, arrival_times=arrived, hellos=hellos, sent=sent, notes=[])

    @property
    def feedback(self) -> str:
        """Name of the feedback force's field: as given in DETAILS, else `load_force`."""
        return f"{self.details.feedback or 'load'}_force"

    @property
    def force_scale(self) -> float:
        """Ratio of this box's load force limit to the nominal one, by which forces of the cases are scaled."""
        told = self.details.load_force_limit
        return told / _LOAD_FORCE_LIMIT if told > 0.0 else 1.0

    @property
    def new_states(self) -> list[protocol.State]:
        """States since the step began."""
        return self.states[self.step_first_state :]

    def confirmation_index(self, sequence: int) -> int:
        """Return the index of the first state that confirms this command or a later one; the number of states if none.

        Sequence numbers are compared for equality: the newest may be of the previous session, and larger.
        """
        first = next((n for n, each in enumerate(self.sent) if each.sequence == sequence), None)
        behind = {sequence} if first is None else {each.sequence for each in self.sent[first:]}
        begin = 0 if first is None else self.sent[first].after
        return next((n for n in range(begin, len(self.states)) if self.states[n].last_command in behind),
                    len(self.states))  # fmt: skip

    def send_hello(self) -> None:
        """Send HELLO, which opens a new session; the reply is stored when it arrives."""
        self.line.write(protocol.encode_hello(0, int(1e6 * self.clock())))

    def send(self, sequence: int | None = None, **changes: Any) -> None:
        """Send the last command with changes, under the next sequence number unless one is given."""
        self.command = apply_changes(self.command, changes)
        self.sequence = (self.sequence + 1 if sequence is None else sequence) % _SEQUENCE_MODULUS
        self.sent.append(SentCommand(self.sequence, self.command, len(self.states)))
        self.line.write(protocol.encode_command(self.sequence, int(1e6 * self.clock()), self.command))

    def receive(self, samples: int, each: Callable[[], None] | None = None) -> None:
        """Receive a number of states, calling `each` after each.

        Raises NoStateError: no state arrives for a second; NoFrameError: nor has any frame arrived before.
        """
        wanted, last = len(self.states) + samples, self.clock()
        while len(self.states) < wanted:
            data = self.line.read(_READ_TIME_MAX)
            now = self.clock()
            gap = 0.0 if self.last_read is None else now - self.last_read
            self.longest_read_gap = max(self.longest_read_gap, gap)
            self.last_read = now
            for frame in self.decoder.feed(data):
                if isinstance(frame, protocol.Hello) and frame.info is not None:
                    self.info = frame.info
                    self.hellos.append((len(self.states), frame))
                elif isinstance(frame, protocol.Details):
                    self.details = frame.details
                elif isinstance(frame, protocol.LawFrame):
                    self.law = frame.record
                elif isinstance(frame, protocol.ClockFrame):
                    self.emulated = self.line.pseudo_terminal  # a device runs in real time
                elif isinstance(frame, protocol.State):
                    self.states.append(frame)
                    self.arrival_times.append(self.clock())
                    last = self.clock()
                    if each is not None and len(self.states) <= wanted:
                        each()
            if self.clock() - last > _SILENCE_MAX:
                if self.decoder.foreign_version is not None and not self.states:
                    raise NoFrameError(protocol.version_mismatch_message(self.decoder.foreign_version))
                if self.decoder.counts.frames:
                    raise NoStateError(f"the box sent no STATE for {_SILENCE_MAX:g} s")
                raise NoFrameError(no_frames_message(self.decoder.counts, LinkCounts(), _SILENCE_MAX))


_LOAD_FORCE_LIMIT = 700.0
"""N, of the nominal bench's box."""
_UNSCALED_FORCE_MIN = 1e6
"""Force [N] from which a value in a case applies to any box, unscaled."""
_FORCE_FIELDS = ("amplitude", "offset")


def apply_changes(command: Command, changes: Mapping[str, Any]) -> Command:
    """Return a command with fields replaced by name, those of its reference included; waveform and law by name."""
    own: dict[str, Any] = dict(changes)
    for name, kind in (("waveform", Waveform), ("law", Law)):
        if name in own:
            own[name] = kind[own[name].upper()]
    shape = {name: own.pop(name) for name in ("waveform", "amplitude", "offset", "frequency", "phase") if name in own}
    return replace(command, reference=replace(command.reference, **shape), **own)


_TIME_OFFSET, _WAVEFORM_OFFSET, _VERSION_OFFSET, _TYPE_OFFSET = 8, 34, 0, 1
"""Byte offsets in a frame's body."""
_FRAME_CHANGES = {
    "waveform 4": (_WAVEFORM_OFFSET, 4),
    "version 9": (_VERSION_OFFSET, 9),
    "type 200": (_TYPE_OFFSET, 200),
}
"""Offset and value of each change; the types from 200 are free for experiments."""


REPLY_SAMPLES = 300
"""Samples within which a HELLO must be answered, and a command confirmed."""
_SESSION_OFFSET = 1000
"""Offset of a session's sequence numbers from those of the previous session."""


def open_session(host: Host) -> None:
    """Send HELLO until the box replies, then safe commands until it confirms one; discard all earlier states."""
    for n in range(3 * REPLY_SAMPLES):
        if n % REPLY_SAMPLES == 0:
            host.send_hello()
        host.receive(1)
        if host.hellos:
            break
    else:
        raise NoStateError(f"the box answered no HELLO within {3 * REPLY_SAMPLES} samples")
    host.receive(2)
    # not a number of the previous session
    host.sequence = (host.states[-1].last_command + _SESSION_OFFSET) % _SEQUENCE_MODULUS
    host.command = Command()
    host.begin_step()
    host.send()
    host.lag = wait_for_confirmation(host, host.send)
    host.receive(20, host.send)
    host.states, host.arrival_times = host.states[-1:], host.arrival_times[-1:]
    host.hellos, host.sent, host.longest_read_gap = [], [], 0.0
    host.begin_step()


def wait_for_confirmation(host: Host, each: Callable[[], None] | None = None) -> int:
    """Wait until the step's first command, or a later one, is confirmed; return the delay in samples."""
    first = host.sent[host.step_first_command]
    for _ in range(REPLY_SAMPLES):  # a lagging host reads old samples first, and the line may buffer bytes
        if (at := host.confirmation_index(first.sequence)) < len(host.states):
            return at - first.after
        host.receive(1, each)
    return 0


def _at_every(every: int, act: Callable[[], None]) -> Callable[[], None]:
    """Return a function that acts at every `every`-th call."""
    calls = count(1)
    return lambda: None if next(calls) % every else act()


def _commands(host: Host, words: dict[str, Any]) -> None:
    """Send a command at once and after every `every`-th sample, `times` times each, for `samples`."""

    def send() -> None:
        for _ in range(words.get("times", 1)):
            host.send()

    each = _at_every(words.get("every", 1), send)
    host.begin_step()
    host.send(**_changes(host, words, "samples", "every", "times"))
    wait_for_confirmation(host, each)
    host.receive(words["samples"], each)


def _once(host: Host, words: dict[str, Any]) -> None:
    """Send one command; `sequence` counts from the last one sent, 0 repeats it."""
    changes = _changes(host, words, "sequence", "samples", "goes_on")
    before, step, samples = host.sequence, words.get("sequence", 1), words.get("samples", 15)
    host.begin_step()
    host.send(before + step, **changes)
    if step == 1 or words.get("goes_on"):
        wait_for_confirmation(host)
    else:  # never confirmed: wait for it to arrive
        host.sequence = before
        samples += host.lag
    host.receive(samples)


def _greet(host: Host, words: dict[str, Any]) -> None:
    """Send HELLO; checks begin after the reply, if there is one."""
    host.begin_step()
    host.details, host.law, host.hello_index = protocol.BoxDetails(), None, len(host.states)
    host.send_hello()
    for _ in range(REPLY_SAMPLES):
        if host.hellos and host.hellos[-1][0] >= host.hello_index:
            host.begin_step()
            host.step_first_state = host.hellos[-1][0]
            break
        host.receive(1)
    host.receive(words.get("samples", 50))


def _garbage(host: Host, words: dict[str, Any]) -> None:
    """Send noise, none of it a frame, before a command after every `every`-th sample, for a number of samples."""
    random = Random(words["seed"])
    host.command = apply_changes(host.command, _changes(host, words, "samples", "every", "seed", "longest"))
    host.begin_step()

    def send() -> None:
        host.line.write(random.randbytes(random.randint(1, words["longest"])) + b"\0")
        host.send()

    host.receive(words["samples"], _at_every(words["every"], send))
    host.receive(5 + host.lag)


def _damaged(host: Host, words: dict[str, Any]) -> None:
    """Send a command that would change the gains, damaged in a way that a box must detect.

    `how`: `bit flipped` and `truncated`, or with a valid check sum `too long`, `too short`, or one of `_FRAME_CHANGES`.
    """
    changes, how = {key: value for key, value in words.items() if key != "how"}, words["how"]
    frame = protocol.encode_command(host.sequence + 1, 0, apply_changes(Command(), changes))
    raw = bytearray(cobs.decode(frame[1:-1]))
    body = raw[:-4]
    if how == "truncated":
        frame = frame[:-9] + b"\0"
    elif how == "bit flipped":
        raw[_TIME_OFFSET] ^= 0x10
        frame = b"\0" + cobs.encode(bytes(raw)) + b"\0"
    else:
        if how == "too long":
            body.append(1)
        elif how == "too short":
            del body[-4:]
        else:
            place, value = _FRAME_CHANGES[how]
            body[place] = value
        frame = protocol.encode_frame(bytes(body))
    host.begin_step()
    host.line.write(frame)
    host.receive(10 + host.lag)


def _changes(host: Host, words: dict[str, Any], *others: str) -> dict[str, Any]:
    """Return a step's changes of the command, with forces scaled to this box.

    A number may be given by the name of an entry of DETAILS.
    """
    changes = {key: value for key, value in words.items() if key not in others}
    for key, value in changes.items():
        if key not in ("waveform", "law") and isinstance(value, str):
            changes[key] = getattr(host.details, value)
        elif key in _FORCE_FIELDS and abs(value) < _UNSCALED_FORCE_MIN:
            changes[key] = host.force_scale * value
        elif key == "delta_u":
            changes[key] = host.correction_scale * value
    return changes


STEP_HANDLERS: dict[str, Callable[[Host, Any], None]] = {
    "commands": _commands,
    "once": _once,
    "wait": lambda host, samples: host.receive(samples),
    "greet": _greet,
    "garbage": _garbage,
    "damaged": _damaged,
}
