# SPDX-License-Identifier: Apache-2.0
"""Host side of the serial line: the state machine of protocol.md, without ROS.

One thread runs `run`: it opens the port, negotiates, passes on each new sample and ensures that a command follows each
sample. Other threads set the guard's inputs (under `lock`) and may `send` at once. CLOSED -> OPEN -> CONNECTED.

Frames count as signs of life, bytes do not: after `silence_max` without a new sample (without a frame, before a box has
answered HELLO) the port is reopened, and the bytes received instead are reported. The reported state of a box, armed or
not, is younger than `SAMPLE_AGE_MAX`.

An emulator that runs by its own clock announces this (CLOCK): stamps and ages are then in its time. If it waits, one
command is sent for each sample, with the sample's time, once the graph has answered (`lock_step`).
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from math import inf, isclose

from hydro_bridge.clock import BoxClock
from hydro_bridge.plant_clock import LockStep
from hydro_bridge.safety.guard import CommandGuard, intersect_limits
from hydro_bridge.safety.plant_interface import PlantInterface
from hydro_bridge.serial import protocol
from hydro_bridge.serial.port import Port, PortLostError
from hydro_bridge.serial.protocol import BoxDetails, BoxInfo, BoxLaw, ClockFrame, Frame, State
from hydro_bridge.serial.stream import Decoder, LinkCounts, SequenceTracker, no_frames_message
from hydro_core.process.realtime import Latency
from hydro_core.signals import STATE_FIELDS, Command, Flag, Law

SAMPLE_AGE_MAX = 0.1
"""Largest age [s] of the last sample at which its content still holds; for a box in real time."""

_HISTORY_LENGTH = 256  # number of samples and commands kept
_SEQUENCE_MASK = 0xFFFFFFFF
_PORT_GRACE_TIME = 2.0  # s from the start for which a missing port is no fault


class _MuteError(PortLostError):
    """The port is open, but no frame of a box arrives."""


class LinkState(Enum):
    """States of the connection."""

    CLOSED = "closed"
    OPEN = "open"
    CONNECTED = "connected"


@dataclass
class LinkStatistics:
    """Statistics of a link since its creation; `LinkCounts` has those of the byte stream.

    Two latencies are measured at every sample, in seconds of one monotonic clock.
    """

    reconnects: int = 0
    """Connections after the first."""
    commands: int = 0
    heartbeats: int = 0
    """Commands sent because no correction arrived in time."""
    turnaround: Latency = field(default_factory=Latency)
    """From receiving a state frame to sending the command with its correction: publishing, the filter, and back."""
    round_trip: Latency = field(default_factory=Latency)
    """From sending a command frame to the first state frame that confirms it; up to one sample of it is the box's."""


class Link(PlantInterface):
    """Host side of the line to one box.

    Parameters
    ----------
    port
        Opened and closed by `run`.
    guard, log, warn, lock_step
        See `PlantInterface`; the guard's limits are narrowed to those of the box on connecting.
    on_state
        Called in the thread of `run` with each new sample, its ROS time [ns], and its flags with FILTER_STALE and PACED
        filled in.
    on_box
        Called in the thread of `run` at each connection with the box's self-description.
    correct
        Called like `on_state`, before it: a filter in this process sets its correction in the guard, and the command
        goes out before the sample is passed on.
    """

    def __init__(
        self,
        port: Port,
        guard: CommandGuard,
        on_state: Callable[[State, int, int], None],
        log: Callable[[str], None],
        warn: Callable[[str], None] | None = None,
        on_box: Callable[[BoxInfo], None] | None = None,
        lock_step: LockStep | None = None,
        correct: Callable[[State, int, int], None] = lambda *sample: None,
    ) -> None:
        super().__init__(guard, log, warn, lock_step)
        self.port = port
        self.lock_step.on_release = self._send
        self.emulator_clock: ClockFrame | None = None
        """CLOCK frame of an emulator; None: the box runs in real time."""
        self.counts = LinkCounts()
        self.statistics = LinkStatistics()
        self._arrived: dict[int, float] = {}  # s of the monotonic clock, by sequence of the last samples
        self._sent: deque[tuple[int, float]] = deque(maxlen=_HISTORY_LENGTH)  # last commands that no sample confirms
        self.clock = BoxClock()
        self.box: BoxInfo | None = None
        self.details: BoxDetails | None = None
        """The box's DETAILS."""
        self.law: BoxLaw | None = None
        """Compensated law of the box; None: it runs the paper's only, and the safe command replaces any command for
        another law."""
        self.refused: tuple[int | None, int | None] = (None, None)
        """Counts of values and references that the box refused since its power-on; None: before the first sample."""
        self.state = LinkState.CLOSED
        self._wanted_limits = guard.settings
        self._on_state, self._correct = on_state, correct
        self._on_box = on_box or (lambda info: None)
        self._decoder, self._tracker = Decoder(self.counts), SequenceTracker(self.counts)
        self._stopping, self._ending = threading.Event(), False
        self._sequence = 0
        self._corrected = True
        self._connected_before = False
        self.last_fault = ""
        """Last fault of a line without a box."""
        self._greeted: BoxInfo | None = None
        """HELLO of a box, until its DETAILS arrive, and its LAW if it offers one."""
        self._told: BoxDetails | None = None
        """DETAILS of such a box, until its LAW arrives."""
        self._clock_told: ClockFrame | None = None  # CLOCK of the box, during the handshake
        self._sampled = -inf  # arrival of the last new sample, s of the monotonic clock
        self._framed = LinkCounts()  # counts at the last frame that kept the line alive
        self._box_us = self._offset_us = 0  # time of the last sample; offset that keeps it ascending
        self._met = False

    @property
    def real_time(self) -> bool:
        """Whether stamps are ROS time, and commands age by the host's clock."""
        return self.emulator_clock is None

    @property
    def paced(self) -> bool:
        """Whether plant and graph run in lock-step: each sample waits for the answers to the previous one."""
        return self.emulator_clock is not None and self.emulator_clock.waits

    def now(self) -> float:
        """Time [s] by which commands and leases age: the host's monotonic clock, or the emulator's own."""
        return time.monotonic() if self.emulator_clock is None else 1e-6 * self._box_us

    def run(self) -> None:
        """Keep the line open until `stop`; body of the serial thread."""
        backoff, path = self.port.settings.backoff_first, self.port.settings.path
        begin, waiting = time.monotonic(), False
        grace = _PORT_GRACE_TIME if path.startswith("/dev/") else 20.0  # an emulator loads longer
        while not self._stopping.is_set():
            try:
                self.port.open()
                self.state = LinkState.OPEN
                self._converse()
            except PortLostError as error:
                foreign = self._decoder.foreign_version is not None and self.state is LinkState.OPEN  # told already
                waited = time.monotonic() - begin
                if not foreign and (self._connected_before or isinstance(error, _MuteError) or waited > grace):
                    self._report_fault(str(error))
                elif not waiting and not foreign and waited > _PORT_GRACE_TIME:
                    waiting = True
                    self._log(f"waiting for {path} to appear")
            if self.state is LinkState.CONNECTED:
                backoff = self.port.settings.backoff_first
            self._leave(LinkState.CLOSED)
            self._decoder.reset()
            self._stopping.wait(backoff)
            backoff = min(2 * backoff, self.port.settings.backoff_max)

    def stop(self) -> None:
        """Disarm, and end `run`; an emulator's sample in reply to the last command is not passed on."""
        self._ending = True
        with self.lock:
            self.guard.set_arm(False)
        self._send()
        self._stopping.set()

    def send(self, corrected: int | None = None) -> None:
        """Send the command that the guard allows now; `corrected` is the sample whose correction has just arrived.

        With a paced plant the answers determine the time: only a command without a correction goes out at once.
        """
        if not self.paced:
            self._send(corrected)
        elif corrected is None:
            self.lock_step.release()

    def _send(self, corrected: int | None = None) -> None:
        with self.lock:
            if corrected is not None:
                self._corrected = True
            if self.state is not LinkState.CONNECTED:
                return
            now = self.now()
            self._sequence = (self._sequence + 1) & _SEQUENCE_MASK
            command = self.guard.command(now)
            if command.law is not Law.PAPER and self.law is None:
                command = Command()  # this box would add the changes to the paper's gains
            time_us = int(1e6 * now) if self.emulator_clock is None else self._box_us - self._offset_us
            frame = protocol.encode_command(self._sequence, time_us, command)
            try:
                if not self.port.write(frame):
                    return
            except PortLostError:
                return  # the reading thread detects it as well, and reopens
            self.statistics.commands += 1
            sent = time.monotonic()
            self._sent.append((self._sequence, sent))
            if corrected is not None and corrected in self._arrived:
                self.statistics.turnaround.add(sent - self._arrived[corrected])

    def _confirms(self, arm: bool, before: int) -> bool:
        heard = self.paced or self.samples > before  # what was heard earlier is no answer
        return heard and super()._confirms(arm, before)

    @property
    def absence_reason(self) -> str:  # type: ignore[override]
        """Reason why no box is connected; empty: one is."""
        return "" if self.state is LinkState.CONNECTED else f"the port is {self.state.value}"

    @property
    def no_sample_message(self) -> str:  # type: ignore[override]
        """Message if the last sample of a connected real-time box is older than `SAMPLE_AGE_MAX`, else empty."""
        age = time.monotonic() - self._sampled
        if self.state is not LinkState.CONNECTED or not self.real_time or age < SAMPLE_AGE_MAX:
            return ""
        return no_frames_message(self.counts, self._framed, age)

    def _converse(self) -> None:
        opened = alive = time.monotonic()
        next_hello, next_sign, frames = 0.0, 0.0, list[Frame]()
        self._framed = replace(self.counts)
        while not self._stopping.is_set():
            data = self.port.read(min(0.02, self.lock_step.poll()) if self.paced else 0.02)
            now = time.monotonic()
            if self.state is LinkState.OPEN and now >= next_hello:
                self.port.write(protocol.encode_hello(0, int(1e6 * now), lock_step=True))
                next_hello = now + 0.1
            if data:
                before = self.samples
                for frame in (frames := self._decoder.feed(data)):
                    self._take(frame, now)
                if self.samples > before or (frames and self.state is LinkState.OPEN):
                    alive, self._framed = time.monotonic(), replace(self.counts)
            if self.state is LinkState.CONNECTED and self.paced and self.lock_step.pending:
                alive = now  # the emulator waits for this end
                if now >= next_sign:
                    self._give_sign()
                    next_sign = now + 1.0
            if self.state is LinkState.OPEN:
                if self._decoder.foreign_version is not None:
                    self._report_fault(protocol.version_mismatch_message(self._decoder.foreign_version))
                elif frames and self._greeted is None and now - opened > self.port.settings.silence_max:
                    self._report_fault("the box sends frames and does not answer HELLO: does the line to it work?")
            waits = self.state is LinkState.CONNECTED and self.paced
            if time.monotonic() - alive > (limit := (self.lock_step if waits else self.port).settings.silence_max):
                raise _MuteError(f"{self.port.settings.path}: {no_frames_message(self.counts, self._framed, limit)}")

    def _give_sign(self) -> None:
        """Report to a waiting emulator that the graph still works on its sample."""
        with self.lock:
            self.port.write(protocol.encode_clock(self._box_us - self._offset_us, waits=True))

    def _take(self, frame: Frame, now: float) -> None:
        if isinstance(frame, State):
            if self.state is LinkState.CONNECTED:
                self._take_state(frame, now)
        elif isinstance(frame, ClockFrame):
            self._clock_told = frame if self.port.pseudo_terminal else None  # a device runs in real time
        elif isinstance(frame, protocol.Hello) and frame.info is not None:
            if not frame.version_min <= protocol.VERSION <= frame.version_max:
                self._report_fault(protocol.version_mismatch_message(frame.version_max))
                return
            if self.state is LinkState.CONNECTED:
                if frame.sequence != 0:
                    return
                self._restarted()
            if frame.sequence != 0:  # the HELLO of power-on answers no greeting
                if self._greeted is not None:
                    said, missing = ("DETAILS", "LAW") if self._told else ("HELLO", "DETAILS")
                    self._report_fault(f"the box sends no {missing} behind its {said}: no command is sent")
                self._greeted, self._told = frame.info, None
        elif isinstance(frame, protocol.Details):
            if self.state is LinkState.CONNECTED:
                if self.details is not None and frame.details.epoch != self.details.epoch:
                    self._restarted()
            elif self._greeted is not None:
                if frame.details.laws >> Law.COMPENSATED & 1:
                    self._told = frame.details
                else:
                    self._connect(self._greeted, frame.details)
        elif isinstance(frame, protocol.LawFrame) and self._greeted is not None and self._told is not None:
            self._connect(self._greeted, self._told, frame.record if frame.law is Law.COMPENSATED else None)

    def _take_state(self, frame: State, now: float) -> None:
        restarts = self.counts.restarts
        if self._ending or not self._tracker.accept(frame.sequence):
            return
        if self.counts.restarts > restarts:
            self._restarted()
            return
        if self.paced and not self._met:
            self.lock_step.wait_for_peers(self._give_sign)
            self._met = True
        self._sampled, self.samples = now, self.samples + 1
        missed, self._corrected = not self._corrected, False
        with self.lock:
            self._offset_us = max(self._offset_us, self._box_us - frame.time_us)  # a restarted box begins anew
            self._box_us = frame.time_us + self._offset_us
            self._arrived[frame.sequence] = now
            self._arrived.pop((frame.sequence - _HISTORY_LENGTH) & _SEQUENCE_MASK, None)
            while self._sent and (frame.last_command - self._sent[0][0]) & _SEQUENCE_MASK < _HISTORY_LENGTH:
                confirmed, sent = self._sent.popleft()
                if confirmed == frame.last_command:
                    self.statistics.round_trip.add(now - sent)
            self.guard.add_sample(frame.sequence, frame.values[STATE_FIELDS.index("nominal_valve_current")])
        before, self.refused = self.refused[1], (frame.refused, frame.refused_references)
        if before == 0 and frame.refused_references > 0:  # once per connection; the counts are on /diagnostics
            self._warn("the box refused a reference and keeps the one before")
        stale = 0 if self.guard.correction_fresh(self.now()) else Flag.FILTER_STALE
        self._update_flags(frame.flags | stale | (0 if self.real_time else Flag.PACED))
        stamp = 1000 * self._box_us  # of an emulator, whose time is its own
        if self.emulator_clock is None:
            stamp = self._ros_time(self.clock.stamp(frame.time_us, time.monotonic_ns()))
        sample = frame, stamp, int(self.flags)
        self._correct(*sample)
        publish = partial(self._on_state, *sample)
        if self.paced:
            self.lock_step.begin_sample(frame.sequence, publish)
        publish()
        if not self.paced and missed and not self._corrected:  # nor for the previous sample: send a command
            self.statistics.heartbeats += 1
            self._send()

    def _connect(self, info: BoxInfo, details: BoxDetails, law: BoxLaw | None = None) -> None:
        self._greeted = self._told = None
        wanted, limits = self._wanted_limits, intersect_limits(self._wanted_limits, info)
        with self.lock:
            self.box, self.details, self.law = info, details, law
            self.state = LinkState.CONNECTED
            # By the clock of the box that has greeted: the host's, or an emulator's own, which never goes back.
            before, self.emulator_clock, self._clock_told = self.emulator_clock, self._clock_told, None
            if self.emulator_clock is not None and before is None:
                waits = ", and waits for answers" if self.emulator_clock.waits else ""
                self._log(f"it is emulated: time is its own{waits}")
            self.guard.settings, self.guard.valve_current_max = limits, info.valve_current_max
            self.guard.set_arm(False)
        self.statistics.reconnects += self._connected_before
        self._connected_before, self._corrected, self.last_fault = True, False, ""
        self._log(f"connected to {info.name or 'a box'} on {self.port.settings.path}; disarmed")
        if law is None:
            self._log("only the paper's force law can be run: the box offers no other")
        changed = [
            f"{name} {before:g} -> {after:g}"
            for (name, before), after in zip(vars(wanted).items(), vars(limits).values(), strict=True)
            if before != after and not isclose(before, after, rel_tol=1e-6)  # HELLO has float32
        ]
        if changed:
            self._log(f"the box narrows the guard: {', '.join(changed)}")
        most = wanted.reference_force_max
        if 0.0 < details.force_range < most:
            self._log(f"the box refuses references beyond {details.force_range:g} N, the guard beyond {most:g} N")
        if 0.0 < (trips := details.load_force_limit) < most:
            self._log(f"the box trips beyond a load force of {trips:g} N, the guard takes references up to {most:g} N")
        self._on_box(info)

    def _restarted(self) -> None:
        self._warn("the box was restarted: it stays disarmed until it is armed again")
        self._leave(LinkState.OPEN)

    def _leave(self, state: LinkState) -> None:
        with self.lock:
            self.guard.set_arm(False)  # before the closed line becomes visible
            self.state, self._greeted, self._told, self._clock_told = state, None, None, None
            if state is LinkState.CLOSED:
                self.port.close()
            self.guard.add_sample(None)
            self._arrived.clear()  # sequence numbers restart
            self._sent.clear()
            self.flags, self.refused = 0, (None, None)
        self._tracker, self.clock = SequenceTracker(self.counts), BoxClock()
        with self._flags_condition:
            self._flags_condition.notify_all()

    def _report_fault(self, sentence: str) -> None:
        """Report a fault once, not at every attempt: sentences that differ only in numbers report the same fault."""
        told, self.last_fault = self.last_fault, sentence
        if re.sub(r"[0-9.]+", "", sentence) != re.sub(r"[0-9.]+", "", told):
            self._warn(sentence)
