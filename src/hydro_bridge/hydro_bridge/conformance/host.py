# SPDX-License-Identifier: Apache-2.0
"""Host side of the line in a conformance test, and an independent implementation of what protocol.md asks of a box.

It shares no code with any box.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from itertools import product
from math import comb, isfinite
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hydro_bridge.serial import protocol
from hydro_bridge.serial.port import Port
from hydro_bridge.serial.protocol import GAIN_FIELDS, PAPER_LAW, BoxDetails, BoxInfo, BoxLaw, State
from hydro_bridge.serial.stream import Decoder, LinkCounts, no_frames_message
from hydro_core.errors import UserError
from hydro_core.signals import FADE_TIME, SAMPLE_PERIOD, STATE_FIELDS, Command, Flag, FloatArray, Waveform
from hydro_core.signals import ReferenceSignal as Signal
from hydro_core.valve_overlap import LEAP, valve_overlap

FLAGS = ("ARMED", "TRIPPED", "WATCHDOG", "FILTER_STALE")
GAINS, REFERENCE = ("proportional_gain", "integral_gain"), ("reference_force", "reference_force_rate")
SHAPING = ("a_0", "a_1", "a_2", "a_3", "a_4", "C_1", "C_2")
COUNTS = ("refused", "refused_references")
ENDS = [(*ends, *[FADE_TIME] * 99) for ends in product((FADE_TIME - 1e-6, FADE_TIME + 1e-6), repeat=3)]
"""Ends of the fades from arming on [s]: each is the 300th or the 301st sample of its fade."""
FADE = [-20.0, 70.0, -84.0, 35.0, 0.0, 0.0, 0.0, 0.0]  # 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7
_RATIOS = np.sqrt([1.0, 3.0, 7.0, 13.0])
LATENCY = 50
"""Samples that a line may take."""
SILENCE = 3.0
"""Time [s] without a sample after which a box counts as silent: a busy host may stand still for a second."""


class SilenceError(UserError, AssertionError):
    """The box sends no STATE."""


def columns(states: Sequence[State]) -> dict[str, FloatArray]:
    """Return the fields of states by name: with those of the force law, flags, and counts since the first state."""
    rows = [(*each.values, *each.law_state[1:3], *each.law_state[3], *each.law_state[4:], each.sequence,
             each.refused - states[0].refused, each.refused_references - states[0].refused_references,
             *(bool(each.flags & flag) for flag in Flag)) for each in states]  # fmt: skip
    names = (*STATE_FIELDS, "f_c", "f_c'", *SHAPING, "sequence", *COUNTS, *(str(flag.name) for flag in Flag))
    return dict(zip(names, np.array(rows, float).T, strict=True))


def expect(states: Sequence[State], name: str, found: FloatArray, right: Any, tolerance: Any) -> None:
    """Check that a field of states is `right` to within `tolerance`."""
    right = np.broadcast_to(right, found.shape)
    for n in np.flatnonzero(~(np.abs(found - right) <= tolerance))[:1]:  # NaN is wrong, too
        raise AssertionError(f"{name} is {found[n]:g} in STATE {states[n].sequence}, {right[n]:g} is right")


def evaluate_signal(signal: Signal, time: FloatArray) -> FloatArray:
    """Return value [N] and four time derivatives of a signal, shape (5, n), `time` [s] after the box accepted it."""
    omega, order = 2.0 * np.pi * signal.frequency, np.arange(5.0)[:, np.newaxis]

    def sine(angle: FloatArray, rate: float) -> FloatArray:
        return np.asarray(rate**order * np.sin(angle + order * np.pi / 2.0))

    shape: FloatArray = np.zeros((5, len(time)))
    if signal.waveform is Waveform.SINE:
        shape = sine(omega * time + signal.phase, omega)
    elif signal.waveform is Waveform.MULTISINE:
        for n, ratio in enumerate(_RATIOS, 1):
            shape += sine(ratio * omega * time + n * signal.phase, ratio * omega) / ratio / sum(1.0 / _RATIOS)
    elif signal.waveform is Waveform.SMOOTH_STEP:  # each half turn begins with an edge of an eighth of a turn
        turn = (signal.frequency * time + signal.phase / (2.0 * np.pi)) % 1.0
        edge = np.where(turn % 0.5 < 0.125, sine(8.0 * np.pi * (turn % 0.5) - np.pi / 2.0, 4.0 * omega), order == 0.0)
        shape = np.where(turn < 0.5, edge, -edge)
    return signal.offset * (order == 0.0) + signal.amplitude * shape


def expected_reference(time: FloatArray, asked: Sequence[Signal], start: float, fades: Sequence[float]) -> FloatArray:
    """Return f_r and its derivatives, shape (5, n), from arming on at the force `start` [N].

    `time` [s], shape (n,). `asked`: the playable signal in force in each sample. The cross-fades end after `fades` [s].
    """
    found, before, begin, old = np.empty((5, len(time))), 0, 0, Signal(offset=start)
    for fade in fades:
        new, now = asked[begin], time[begin:] - time[begin]
        last, following = evaluate_signal(old, time[begin:] - time[before]), evaluate_signal(new, now)
        share = [np.polyval(np.polyder(FADE, n), now / FADE_TIME) / FADE_TIME**n for n in range(5)]
        mixed = last + [sum(comb(n, j) * share[j] * (following - last)[n - j] for j in range(n + 1)) for n in range(5)]
        found[:, begin:] = np.where(now < fade, mixed, following)
        changes = [n for n in range(begin + int(np.sum(now < fade)), len(time)) if asked[n] != new]
        if not changes:
            break
        old, before, begin = new, begin, changes[0]
    return found


def gain_and_stiffness(
    bench: Mapping[str, Any], position: Any, pressure_a: Any, pressure_b: Any, current: Any
) -> tuple[FloatArray, FloatArray]:
    """Return g [N/s/A] for currents of this sign, and the stiffness [N/m] of the velocity term h."""
    its = SimpleNamespace(**bench)
    high, low, large, small = its.supply_pressure, its.tank_pressure, its.piston_area, its.area_ratio * its.piston_area
    per_a = its.bulk_modulus * large / (its.dead_volume_a + large * position)
    per_b = its.bulk_modulus * small / (its.dead_volume_b + small * (its.stroke - position))
    drops = np.where(current >= 0.0, (high - pressure_a, pressure_b - low), (pressure_a - low, high - pressure_b))
    openings = np.sign(drops) * np.sqrt(np.abs(drops) / (0.5 * its.valve_nominal_pressure_drop))
    flows = its.valve_nominal_flow / its.valve_nominal_current * openings
    return per_a * flows[0] + per_b * flows[1], large * per_a + small * per_b


class Host:
    """One session with a box: commands sent, states received. It begins and ends disarmed.

    `line`: a port, or a box that is run in lock-step; `clock`: its time, s; `bench`: what the box's law believes, if
    known; `moving`: whether the box may be armed.
    """

    def __init__(
        self, line: Port, clock: Callable[[], float] = time.monotonic, bench: Mapping[str, Any] | None = None,
        moving: bool = False,
    ) -> None:  # fmt: skip
        self.line, self.clock, self.bench, self.moving, self.decoder = line, clock, bench, moving, Decoder()
        self.info, self.details, self.hello = BoxInfo(), BoxDetails(), -1
        """What the box says of itself, and the sequence of its last HELLO; -1: none came."""
        self.law: BoxLaw | None = None
        """Its compensated law."""
        self.feedback, self.force_scale = "load_force", 1.0
        """Field of the feedback force; ratio of the box's load force limit to the nominal one, 700 N."""
        self.states: list[State] = []
        self.acting: list[tuple[Command, int]] = []
        """For each state the command in force, the safe one behind a HELLO, and the samples since it came."""
        self.command, self.sequence, self.commands = Command(), 0, dict[int, Command]()
        """The last command, its sequence number, and all that were sent, by sequence number."""
        self.read_at, self.longest_read_gap = clock(), 0.0
        """Time of the last read, and the longest one between two [s]."""
        self._frames, self._in_force = deque[protocol.Frame](), (Command(), 0)

    def receive(self, samples: int, *, times: int = 0, every: int = 1) -> None:
        """Receive states, and send the command `times` after each `every`-th; raises SilenceError after a `SILENCE`."""
        end, last = len(self.states) + samples, self.clock()
        while len(self.states) < end:
            while not self._frames:
                self._frames += self.decoder.feed(self.line.read(0.005))
                before, self.read_at = self.read_at, self.clock()
                self.longest_read_gap = max(self.longest_read_gap, self.read_at - before)
                if self.read_at - last > SILENCE and not self._frames:
                    told, counts = f"the box sent no STATE for {SILENCE:g} s", self.decoder.counts
                    raise SilenceError(told if counts.frames else no_frames_message(counts, LinkCounts(), SILENCE))
            match frame := self._frames.popleft():
                case protocol.Hello(info=BoxInfo() as info):
                    self.info, self.law, self.hello, self._in_force = info, None, frame.sequence, (Command(), -1)
                case protocol.Details():
                    self.details, self.feedback = frame.details, f"{frame.details.feedback or 'load'}_force"
                    self.force_scale = frame.details.load_force_limit / 700.0 or 1.0
                case protocol.LawFrame():
                    self.law = frame.record
                case State():
                    if not self.states or frame.last_command != self.states[-1].last_command:
                        self._in_force = self.commands.get(frame.last_command, Command()), -1
                    self._in_force = self._in_force[0], self._in_force[1] + 1
                    self.acting.append(self._in_force)
                    self.states.append(frame)
                    last = self.clock()
                    for _ in range(0 if len(self.states) % every else times):
                        self.send()

    def send(self, ahead: int = 1, noise: bytes = b"", **changes: Any) -> None:
        """Send the last command with changes, `ahead` of the last number; leave the case out if it may not be sent.

        Forces are scaled to this box, and a correction so that it moves no more, in proportion, than on the nominal
        bench, whose g is 10.53e6 N/s/A.
        """
        if changes.get("arm") and not self.moving:
            pytest.skip("may move the piston: --moving")
        if changes.get("law") and not self.law:
            pytest.skip("the box runs the paper's law only")
        if self.bench is not None and "delta_u" in changes:
            supply = 0.5 * self.bench["supply_pressure"]
            gain, _ = gain_and_stiffness(self.bench, 0.5 * self.bench["stroke"], supply, supply, 1.0)
            changes["delta_u"] *= min(1.0, self.force_scale * 10.53e6 / float(gain))
        signal = {entry.name: changes.pop(entry.name) for entry in fields(Signal) if entry.name in changes}
        signal |= {name: self.force_scale * signal[name] for name in signal.keys() & {"amplitude", "offset"}}
        self.command = replace(self.command, reference=replace(self.command.reference, **signal), **changes)
        self.sequence = (self.sequence + ahead) % 2**32
        self.commands[self.sequence] = self.command
        self.line.write(noise + protocol.encode_command(self.sequence, int(1e6 * self.clock()), self.command))

    def stream(self, samples: int, *, times: int = 1, every: int = 1, **changes: Any) -> None:
        """Send a command and, after every `every`-th sample, `times` more, for `samples` behind the confirmation."""
        earlier = len(self.commands)
        self.send(**changes)
        for _ in range(300):  # a lagging host reads old samples first, and the line may buffer bytes
            self.receive(1, times=times, every=every)
            if self.states[-1].last_command in [*self.commands][earlier:]:
                return self.receive(samples, times=times, every=every)
        raise AssertionError("no command was taken within 300 samples")

    def greet(self, within: int = 300) -> None:
        """Send HELLO, whose answer must come `within` samples, and receive 30 samples."""
        begin, self.details, self.hello = len(self.states), BoxDetails(), -1
        self.line.write(protocol.encode_hello(0, int(1e6 * self.clock())))
        while self.hello < 0:
            assert len(self.states) < begin + within, f"no HELLO came within {within} samples"
            self.receive(1)
        self.receive(30)

    def open(self) -> None:
        """Greet the box, and send it safe commands until it confirms one; discard all earlier states."""
        with suppress(AssertionError):  # the first bytes of a line may be lost
            self.greet()
        self.greet()
        self.sequence = self.states[-1].last_command + 1000  # not a number of the previous session
        with suppress(AssertionError):
            self.stream(20)
        self.states, self.acting, self.longest_read_gap = self.states[-1:], self.acting[-1:], 0.0

    def check(self, *names: str) -> None:
        """Check these fields of all states by the commands in force."""
        states, now, counts = self.states, columns(self.states), self.decoder.counts
        paper = replace(PAPER_LAW, **{name: getattr(self.info, name) for name in GAIN_FIELDS})
        laws = paper, self.law or paper
        rows, signals, shown = [], [Signal()], (False, False, True)
        for state, (command, age) in zip(states, self.acting, strict=True):
            number, late = state.law_state.law, bool(state.flags & Flag.WATCHDOG)
            law = laws[number]
            low, safe, high, _ = ([0.0, 0.0, *numbers] for numbers in law.shaping_limits)
            low[:2], high[:2] = (law.delta_kp_min, law.delta_ki_min), (law.delta_kp_max, law.delta_ki_max)
            asked = np.array([command.delta_kp, command.delta_ki, *command.shaping])
            taken = np.clip(np.where(np.isfinite(asked), asked, safe), low, high)
            acting = list(safe if late or command.law is not number else taken)
            signal, most = command.reference, (1.0 + 1e-9) * (self.details.force_range or 1e6)
            timed = signal.waveform is Waveform.HOLD or 0.0 < signal.frequency < 1000.0
            plays = timed and isfinite(signal.frequency + signal.phase)
            plays = plays and 0.0 <= signal.amplitude <= most - abs(signal.offset)
            signals.append(signal if plays else signals[-1])
            armed, tripped, disarm_seen = shown
            if age > 200:
                shown = False, tripped or armed, False
            elif not command.arm:
                shown = False, False, True
            elif not armed and not tripped:
                shown = disarm_seen, not disarm_seen, disarm_seen
            refused = np.sum(asked != taken) + (not abs(command.delta_u) <= self.info.delta_u_max) + (not plays)
            acting[:2] = law.base_kp + acting[0], law.base_ki + acting[1]
            rows.append((*shown[:2], age > 50, late or not command.filter_fresh, (age == 0) * refused,
                         (age == 0) * (not plays), *acting[:2], *safe[2:], *acting[2:],
                         0.0 if age > 3 else np.nan_to_num(command.delta_u), age in (50, 200)))  # fmt: skip
        *rest, delta_u, rounding = np.array(rows, float).T  # rounding: a time-out may come a sample later
        right: dict[str, Any] = {name: np.zeros((2, len(rows))) for name in now}  # values, tolerances of a box at rest
        for name, value in zip((*FLAGS, *COUNTS, *GAINS, *SHAPING), rest, strict=False):
            right[name][0] = np.cumsum(value) if name in COUNTS else value
            right[name][1] = rounding * (name in FLAGS) + 1e-6 * np.abs(value) * (name in GAINS)
        right["reference_force"][0] = right["f_c"][0] = now[self.feedback]
        right["sequence"][0] = now["sequence"][0] + np.arange(len(rows))
        for first, end in np.flatnonzero(np.diff(now["ARMED"], prepend=0.0, append=0.0)).reshape(-1, 2):
            part, time = slice(first, end), 1e-6 * np.array([state.time_us for state in states[first:end]])
            told = {name: column[part] for name, column in now.items()}
            law, shaping = laws[states[first].law_state.law], np.array(rest[-len(SHAPING) :])[:, part]
            points = (expected_reference(time, signals[1:][part], told[self.feedback][0], fades) for fades in ENDS)
            tries = [self._armed(law, told, each, shaping, delta_u[part]) for each in points]
            misfits = [sum(np.abs(each[name][0] - told[name]).sum() for name in (*REFERENCE, "f_c'")) for each in tries]
            for name, pair in tries[int(np.argmin(misfits))].items():
                right[name][0][part], right[name][1][part] = pair
        for name in names:
            expect(states, name, now[name], *right[name])
        damaged = counts.malformed + counts.crc_errors
        assert not damaged or "sequence" not in names, f"{damaged} frames are damaged"

    def _armed(
        self, law: BoxLaw, now: Mapping[str, FloatArray], points: FloatArray, shaping: FloatArray, delta_u: FloatArray
    ) -> dict[str, tuple[Any, Any]]:
        """Return right values and tolerances of the force law's fields from arming on, n samples.

        `points`: f_r and its derivatives, shape (5, n). `shaping`: wanted, shape (7, n). `delta_u`: in force, A. What
        follows from other fields follows from these as the box tells them, `now`. The integral is frozen while the
        current is at its limit and K_i (f_r - f) has its sign.
        """
        force, limit = self.force_scale, self.info.valve_current_max
        right: dict[str, tuple[Any, Any]] = {}
        for name, wanted, off in zip(REFERENCE, points, (0.01, 0.5), strict=False):
            right[name] = wanted, force * off + 1e-4 * np.abs(wanted)

        low, safe, high, rate = np.array(law.shaping_limits)[..., np.newaxis]
        told = np.array([now[name] for name in SHAPING])
        before = np.column_stack((safe, told[:, :-1]))
        steps = np.clip(shaping - before, -rate * SAMPLE_PERIOD, rate * SAMPLE_PERIOD)
        right |= zip(SHAPING, zip(before + steps, 2e-6 * np.maximum(abs(low), abs(high)), strict=True), strict=True)
        value, rise, one = now["reference_force"], now["reference_force_rate"], np.ones(len(points.T))
        terms = np.array([value, rise, points[2], one, points[3]])
        slopes = np.array([rise, points[2], points[3], 0.0 * one, points[4]])
        value = (told[:5] * terms).sum(axis=0)
        slope = (told[:5] * slopes + (told - before)[:5] / SAMPLE_PERIOD * terms).sum(axis=0)
        right["f_c"] = np.clip(value, -law.reference_max, law.reference_max), 0.02 * force
        right["f_c'"] = np.where(np.abs(value) > law.reference_max, 0.0, slope), 1.0 * force

        if bench := self.bench:
            paper, gain, current = self.info.integral == "paper", now["integral_gain"], now["valve_current"]
            error, missed = now["f_c"] - now[self.feedback], now["reference_force"] - now[self.feedback]
            frozen = (np.abs(current) >= (1.0 - 1e-6) * limit) & (current * gain * missed > 0.0)
            summed = SAMPLE_PERIOD * np.where(frozen, 0.0, missed if paper else gain * missed)
            integral = (np.cumsum(summed) - summed) * (gain if paper else 1.0)
            alpha, position = bench["area_ratio"], np.clip(now["piston_position"], 0.0, bench["stroke"])
            rest, pressures = bench["supply_pressure"] / (1.0 + alpha), (now["pressure_a"], now["pressure_b"])
            least = 0.1 * gain_and_stiffness(bench, bench["spring_rest_position"], alpha * rest, rest, 1.0)[0]
            moving = gain_and_stiffness(bench, position, *pressures, 1.0)[1] * now["piston_velocity"]
            driven = now["f_c'"] + now["proportional_gain"] * error + integral + now["C_1"] * moving
            gained = now["C_2"] * gain_and_stiffness(bench, position, *pressures, driven)[0]
            nominal, overlap = driven / np.maximum(gained, least), valve_overlap(bench.get("effects", ()))
            share = np.clip((nominal - overlap["closing"]) / (LEAP * limit), -1.0, 1.0)
            nominal += share * np.where(share < 0.0, overlap["back"], overlap["out"])
            right["nominal_valve_current"] = nominal, 2e-7 + 1e-4 * np.abs(nominal)

        whole = now["nominal_valve_current"] + delta_u
        cut = np.clip(whole, -limit, limit)
        right["valve_current"] = cut, 1e-7 + 1e-6 * np.abs(cut)
        right["SATURATED"] = np.abs(whole) > limit, np.abs(np.abs(whole) - limit) <= 1e-6
        return right
