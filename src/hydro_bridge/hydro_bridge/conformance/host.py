# SPDX-License-Identifier: Apache-2.0
"""Host side of the line in a conformance test: `Host` sends what a rule says, a `Step` is what came back.

Checks raise AssertionError with a sentence.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
from cobs import cobs

from hydro_bridge.conformance.reference import columns, expect, force_gain
from hydro_bridge.serial import protocol
from hydro_bridge.serial.port import Port
from hydro_bridge.serial.protocol import State
from hydro_bridge.serial.stream import Decoder, LinkCounts, no_frames_message
from hydro_core.errors import UserError
from hydro_core.signals import Command, Flag, flag_names

REPLY_SAMPLES = 300
"""Samples within which a HELLO must be answered, and a command confirmed."""


class SilenceError(UserError):
    """The box sends no STATE."""


@dataclass(frozen=True)
class Step:
    """States received in a step of a session: the last one before it and all since, and those since its command."""

    host: Host
    states: Sequence[State]
    confirmed: Sequence[State]

    def has(self, flags: int = 0, lacks: int = 0) -> Step:
        """Check the flags of all confirmed states."""
        for state in self.confirmed:
            right = state.flags & (flags | lacks) == flags
            assert right, f"STATE {state.sequence} has {flag_names(state.flags)}"
        return self

    def gains(self, delta_kp: float, delta_ki: float) -> Step:
        """Check that all confirmed states have the paper's base gains and these changes."""
        expect(self.confirmed, "proportional_gain", self.host.info.base_kp + delta_kp, 1e-3)
        expect(self.confirmed, "integral_gain", self.host.info.base_ki + delta_ki, 1e-3)
        return self

    def has_refused(self, values: int, references: int) -> None:
        """Check how many values and references the box counted as refused in this step."""
        last, first = self.states[-1], self.states[0]
        found = last.refused - first.refused, last.refused_references - first.refused_references
        assert found == (values, references), f"it counted {found[0]} values and {found[1]} references"

    def rests(self) -> None:
        """Check that the confirmed states are those of a disarmed box."""
        for name in ("valve_current", "nominal_valve_current", "reference_force_rate"):
            expect(self.confirmed, name, 0.0, 0.0)
        expect(self.confirmed, "reference_force", columns(self.confirmed)[self.host.feedback], 0.0)
        self.has(lacks=Flag.ARMED)

    def is_late(self) -> None:
        """Check that WATCHDOG comes 50 ms behind the last command, with base gains, no correction, FILTER_STALE."""
        self.flag_comes(Flag.WATCHDOG, 50)
        late = [state for state in self.states[1:] if state.flags & Flag.WATCHDOG]
        Step(self.host, late, late).has(Flag.FILTER_STALE).gains(0.0, 0.0)
        whole = [state for state in late if not state.flags & Flag.SATURATED]
        assert all(state.values[8] == state.values[9] for state in whole), "the correction is still added"

    def flag_comes(self, flag: Flag, samples: int) -> None:
        """Check that a flag comes `samples` after the last command that the box took, or one more (rounding)."""
        states = self.host.states
        since = next(n for n, state in enumerate(states) if state.last_command == states[-1].last_command)
        found = next((n for n, state in enumerate(states[since:]) if state.flags & flag), -1)
        assert samples <= found <= samples + 1, f"{flag.name} came {found} samples behind the last command (-1: never)"

    def is_whole(self) -> None:
        """Check that no sample is missing or repeated, and that every frame of the session is complete."""
        expect(self.states[1:], "the step of its number", 1, 0, np.diff([state.sequence for state in self.states]))
        counts = self.host.decoder.counts
        assert not counts.malformed, f"{counts.crc_errors} check sums, {counts.malformed} frames are wrong"


class Host:
    """One session with a box: commands sent, states received. It begins and ends disarmed.

    `line`: a port, or a box that is run in lock-step; `clock`: its time, s; `bench`: what the box's law believes.
    """

    def __init__(
        self, line: Port, clock: Callable[[], float] = time.monotonic, bench: Mapping[str, Any] | None = None
    ) -> None:
        self.line, self.clock, self.bench, self.decoder = line, clock, bench, Decoder()
        self.info, self.details = protocol.BoxInfo(), protocol.BoxDetails()
        self.law: protocol.BoxLaw | None = None
        self.hello: tuple[int, int] | None = None
        """Of the box's last HELLO its sequence and the number of states before it."""
        self.states: list[State] = []
        self.arrival_times: list[float] = []
        self.command, self.sequence = Command(), 0
        self.commands: dict[int, Command] = {}
        """All that were sent, by sequence number."""
        self.emulated, self.lag, self.longest_read_gap = False, 0, 0.0
        """Whether the box sent CLOCK; samples by which the line delays a confirmation; s between two reads."""
        self.notes: list[str] = []
        """What a passed case could not examine."""

    @property
    def feedback(self) -> str:
        """Name of the feedback force's field: as given in DETAILS, else `load_force`."""
        return f"{self.details.feedback or 'load'}_force"

    @property
    def force_scale(self) -> float:
        """Ratio of this box's load force limit to the nominal one, 700 N, by which forces of the cases are scaled."""
        return self.details.load_force_limit / 700.0 or 1.0

    @property
    def armed(self) -> list[State]:
        """All armed states of the session."""
        states = [state for state in self.states if state.flags & Flag.ARMED]
        assert states, "it was not armed"
        return states

    def receive(self, samples: int, each: Callable[[], object] = lambda: None) -> None:
        """Receive a number of states, calling `each` after each; raises SilenceError after a second without any."""
        wanted, read, last = len(self.states) + samples, self.clock(), self.clock()
        while len(self.states) < wanted:
            data, before, read = self.line.read(0.005), read, self.clock()
            self.longest_read_gap = max(self.longest_read_gap, read - before)
            for frame in self.decoder.feed(data):
                if isinstance(frame, protocol.Hello) and frame.info is not None:
                    self.info, self.hello = frame.info, (frame.sequence, len(self.states))
                elif isinstance(frame, protocol.Details):
                    self.details = frame.details
                elif isinstance(frame, protocol.LawFrame):
                    self.law = frame.record
                elif isinstance(frame, protocol.ClockFrame):
                    self.emulated = self.line.pseudo_terminal  # a device runs in real time
                elif isinstance(frame, State):
                    last = self.clock()
                    self.states.append(frame)
                    self.arrival_times.append(last)
                    if len(self.states) <= wanted:
                        each()
            if self.clock() - last > 1.0:
                told = protocol.version_mismatch_message(self.decoder.foreign_version or protocol.VERSION)
                if self.decoder.foreign_version is None:
                    told = no_frames_message(self.decoder.counts, LinkCounts(), 1.0)
                raise SilenceError("the box sent no STATE for 1 s" if self.decoder.counts.frames else told)

    def send(self, ahead: int = 1, noise: bytes = b"", **changes: Any) -> None:
        """Send the last command with changes, `ahead` of the last number.

        Forces are scaled to this box, and a correction so that it moves no more, in proportion, than on the nominal
        bench, whose g is 10.53e6 N/s/A.
        """
        if self.bench is not None and "delta_u" in changes:
            supply = 0.5 * self.bench["supply_pressure"]
            gain = force_gain(self.bench, 0.5 * self.bench["stroke"], supply, supply, 1.0)
            changes["delta_u"] *= min(1.0, self.force_scale * 10.53e6 / float(gain))
        for name in changes.keys() & {"amplitude", "offset"}:
            changes[name] *= self.force_scale
        names = changes.keys() & {"waveform", "amplitude", "offset", "frequency", "phase"}
        signal = {name: changes.pop(name) for name in names}
        self.command = replace(self.command, **changes)
        self.command = replace(self.command, reference=replace(self.command.reference, **signal))
        self.sequence = (self.sequence + ahead) % 2**32
        self.commands[self.sequence] = self.command
        self.line.write(noise + protocol.encode_command(self.sequence, int(1e6 * self.clock()), self.command))

    def stream(self, samples: int, *, ahead: int = 1, every: int = 1, times: int = 1, **changes: Any) -> Step:
        """Send a command and, after every `every`-th sample, `times` more, for `samples` behind the confirmation.

        Raises AssertionError: the box confirms none.
        """
        begin, earlier, calls = len(self.states) - 1, len(self.commands), count(1)

        def each() -> None:
            for _ in range(0 if next(calls) % every else times):
                self.send()

        self.send(ahead, **changes)
        for _ in range(REPLY_SAMPLES):  # a lagging host reads old samples first, and the line may buffer bytes
            self.receive(1, each)
            if self.states[-1].last_command in [*self.commands][earlier:]:
                break
        else:
            raise AssertionError(f"no command was taken within {REPLY_SAMPLES} samples")
        at = len(self.states) - 1
        self.receive(samples, each)
        return Step(self, self.states[begin:], self.states[at:])

    def once(self, *, ahead: int = 1, samples: int = 15, **changes: Any) -> Step:
        """Send one command."""
        return self.stream(samples, ahead=ahead, times=0, **changes)

    def wait(self, samples: int) -> Step:
        """Receive a number of states, and what is under way, without a command."""
        begin = len(self.states) - 1
        self.receive(samples + self.lag)
        return Step(self, self.states[begin:], self.states[begin + 1 :])

    def body(self, ahead: int = 1) -> bytes:
        """Return a COMMAND with another K_p as it stands in a frame, without its CRC."""
        changed = replace(self.command, delta_kp=self.command.delta_kp + 3.0)
        return cobs.decode(protocol.encode_command((self.sequence + ahead) % 2**32, 0, changed)[1:-1])[:-4]

    def send_wrong(self, frame: bytes, samples: int = 5) -> Step:
        """Send a frame with another K_p, and check that the box does not take it."""
        self.line.write(frame)
        step = self.wait(samples)
        expect(step.confirmed, "proportional_gain", columns(step.states[:1])["proportional_gain"], 0.0)
        return step

    def greet(self, within: int = REPLY_SAMPLES) -> Step:
        """Send HELLO, and receive the states since its answer, which must come `within` samples and the line's lag."""
        begin, self.details, self.law, self.hello = len(self.states), protocol.BoxDetails(), None, None
        self.line.write(protocol.encode_hello(0, int(1e6 * self.clock())))
        while self.hello is None:
            assert len(self.states) < begin + within + self.lag, f"no HELLO came within {within + self.lag} samples"
            self.receive(1)
        self.receive(30)
        return Step(self, self.states[self.hello[1] - 1 :], self.states[self.hello[1] :])

    def open(self) -> None:
        """Greet the box, and send it safe commands until it confirms one; discard all earlier states."""
        with suppress(AssertionError):
            self.greet()
        if self.hello is None:
            self.greet()
        self.sequence = self.states[-1].last_command + 1000  # not a number of the previous session
        with suppress(AssertionError):
            step = self.stream(20)
            self.lag = len(step.states) - len(step.confirmed) - 1
        self.states, self.arrival_times, self.commands = self.states[-1:], self.arrival_times[-1:], {}
        self.longest_read_gap = 0.0

    def close(self) -> None:
        """Disarm the box."""
        self.command = Command()
        self.receive(10 + self.lag, self.send)
