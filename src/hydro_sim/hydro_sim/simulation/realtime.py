# SPDX-License-Identifier: Apache-2.0
"""Real-time simulation of box and plant, without ROS: the core of the sim node.

One thread runs `run`, a sample at a time: ask the guard, tick the box, hand the sample on, step the plant. Other
threads tell the guard what is wanted (under `lock`), `arm`, and report corrections and gains. The bridge's `Link` is
its counterpart.

======== ==========================================================================================================
speed    pace, and the clock on which commands age
======== ==========================================================================================================
1        one sample per millisecond; the host's
other    that many simulated seconds per second; the simulation's
0        lock-step with filter and trainer (`LockStep`), real time until one is there; the simulation's
======== ==========================================================================================================
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from hydro_bridge.link.clock import HostClock, clock_step_message
from hydro_bridge.process.realtime import Pacer, exact_timers
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.serial.protocol import LawState
from hydro_bridge.settings import check, quantity
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_DTYPE, Command, Flag, FloatArray, flag_names
from hydro_sim.box.box import Box, law_state
from hydro_sim.model.plant import Plant

RESEND = 0.25
"""Time [s] after which an unanswered sample is sent again: the state is published best effort."""


class LockStep:
    """Lock-step: the next sample waits for the graph's answers to the last one.

    ::

        sample k ──> filter ──> correction for k ──┐
        10 samples ──> trainer ──> gains ──────────┴──> sample k + 1

    A node that has not been heard yet is not waited for, nor is a trainer while the plant is disarmed. A node that
    falls silent is named in the log, and the simulation continues without it until it returns.

    `log`: called with a sentence when a peer comes or falls silent. `silence_max`: longest wait [s] for a peer.
    """

    def __init__(self, log: Callable[[str], None], *, silence_max: float = 5.0) -> None:
        self._log, self._silence_max = log, silence_max
        self._news = threading.Condition()
        self._filter = self._trainer = self._released = False
        self._corrected = self._ungained = 0

    @property
    def engaged(self) -> bool:
        """Whether any node is waited for."""
        return self._filter or self._trainer

    def corrected(self, sequence: int) -> None:
        """Note that the filter has answered sample `sequence`."""
        with self._news:
            if not self._filter:
                self._log("in lock-step with the filter")
            self._filter, self._corrected = True, sequence
            self._news.notify_all()

    def gained(self) -> None:
        """Note that the trainer has sent gains."""
        with self._news:
            if not self._trainer:
                self._log("in lock-step with the trainer")
            self._trainer, self._ungained = True, 0
            self._news.notify_all()

    def release(self) -> None:
        """Let the present sample go without an answer: a caller in the answering thread waits for the next one."""
        with self._news:
            self._released = True
            self._news.notify_all()

    def wait(self, sequence: int, armed: bool, resend: Callable[[], None]) -> None:
        """Return when sample `sequence`, the last one published, has its answers."""
        give_up = time.monotonic() + self._silence_max
        self._ungained = self._ungained + 1 if armed else 0
        with self._news:
            while self.awaited(sequence) and not self._released:
                if self._news.wait(RESEND):
                    continue
                if time.monotonic() >= give_up:
                    self._go_on_without(sequence)
                else:
                    resend()
            self._released = False

    def awaited(self, sequence: int) -> list[str]:
        """Return the nodes that have yet to answer sample `sequence`."""
        behind = (sequence - self._corrected) & 0xFFFFFFFF
        uncorrected = self._filter and 1 <= behind < 1 << 31
        return ["filter"] * uncorrected + ["trainer"] * (self._trainer and self._ungained >= SAMPLES_PER_STEP)

    def _go_on_without(self, sequence: int) -> None:
        silent = self.awaited(sequence)
        self._filter = self._filter and "filter" not in silent
        self._trainer = self._trainer and "trainer" not in silent
        sentence = f"no answer of the {' and '.join(silent)} to sample {sequence} for {self._silence_max:g} s"
        self._log(sentence + ": going on without until it is back")


_NOMINAL = (STATE_DTYPE.names or ()).index("nominal_valve_current")


@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """Settings of the sim node."""

    model: str = ""
    """Bench file, `shipped` (learned bench) or `analytic`; empty: `analytic` if `bench` is given, `shipped` if not."""
    bench: str = ""
    """Path of a bench.yaml or a diagnosis' corrected.yaml; empty: the one that comes with hydro_sim."""
    box_bench: str = ""
    """Path of the bench.yaml that the box's force law believes; empty: the same as `bench`."""
    speed: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0
    """Simulated seconds per second; 0: in lock-step with filter and trainer, as fast as they answer."""
    noise: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0
    """Scale of the sensors' noise and quantisation."""
    seed: Annotated[int, quantity("-", 0, 4294967295)] = 0
    """Seed of the noise."""
    silence_max: Annotated[float, quantity("s", 0.1, 600.0)] = 5.0
    """How long lock-step waits for a peer."""

    def __post_init__(self) -> None:
        check(self)


class Simulation:
    """A running simulation.

    Parameters
    ----------
    box, plant, guard
        The parts; `run` alone touches box and plant.
    settings
        Pace and seed.
    on_state
        Called in the thread of `run` with each sample's stamp [ns], ROS time at speed 1, else the simulation's own, and
        with its record as a tuple in the order of STATE_DTYPE.
    log
        Called with a sentence when something changes.
    """

    def __init__(
        self,
        box: Box,
        plant: Plant,
        guard: CommandGuard,
        settings: SimSettings,
        on_state: Callable[[int, tuple[Any, ...]], None],
        log: Callable[[str], None],
    ) -> None:
        self.guard, self.settings = guard, settings
        self.lock = threading.Lock()
        self.steps = LockStep(log, silence_max=settings.silence_max)
        self.pacer = Pacer(SAMPLE_PERIOD / settings.speed if settings.speed > 0.0 else SAMPLE_PERIOD)
        self.host_clock = HostClock()
        self.samples = 0
        self.flags = 0
        self._box, self._plant = box, plant
        self._on_state, self._log = on_state, log
        self._stopping = threading.Event()
        self._confirmed = threading.Condition()
        self._began = time.monotonic()

    @property
    def real_time(self) -> bool:
        """Whether stamps are ROS time and commands age by the host's clock."""
        return self.settings.speed == 1.0

    @property
    def law_state(self) -> LawState | None:
        """Force law as it acted in the present sample, for `on_state` alone; None: the paper's."""
        state = self._box.state[0]
        return law_state(state) if state["acting"]["law"] else None

    def clock(self) -> float:
        """The guard's clock [s]."""
        return time.monotonic() if self.real_time else self.samples * SAMPLE_PERIOD

    def speed_reached(self) -> float:
        """Simulated seconds per second since the start."""
        return self.samples * SAMPLE_PERIOD / max(time.monotonic() - self._began, SAMPLE_PERIOD)

    def run(self) -> None:
        """Simulate until `stop`; the body of the plant's thread."""
        exact_timers()
        measurement = self.warm_up()
        self._began = time.monotonic()
        self.pacer.restart()
        while not self._stopping.is_set():
            now = self.samples * SAMPLE_PERIOD
            with self.lock:
                command = self.guard.command(self.clock())
            self._box.receive(command, now)
            sample = self._box.tick(measurement, now)
            stamp = self._stamp()
            fields: tuple[Any, ...] = sample.item()  # type: ignore[assignment]
            with self.lock:
                self.guard.note_sample(fields[1], fields[_NOMINAL])
            self._on_state(stamp, fields)
            measurement = self._plant.step(fields[10])
            self._note_flags(fields[-1])
            self._wait(fields[1], partial(self._on_state, stamp, fields))
            self.samples += 1

    def stop(self) -> None:
        """End `run`."""
        self._stopping.set()
        self.steps.release()

    def send(self, corrects: int | None = None) -> None:
        """Accept a correction for sample `corrects`; it is sent with the next sample."""
        if corrects is not None and self.settings.speed == 0.0:
            self.steps.corrected(corrects)

    def gained(self) -> None:
        """Note that gains have arrived."""
        if self.settings.speed == 0.0:
            self.steps.gained()

    def arm(self, arm: bool, timeout: float = 0.5) -> str:
        """Arm or disarm and wait for the box to confirm; return why not, or nothing. Not for the thread of `run`."""
        with self.lock:
            if arm and self.flags & Flag.TRIPPED:
                return f"the box has tripped ({flag_names(self.flags)}): disarm it, then arm it"
            self.guard.set_arm(arm)
        self.steps.release()
        with self._confirmed:
            if self._confirmed.wait_for(lambda: bool(self.flags & Flag.ARMED) == arm, timeout):
                return ""
        with self.lock:
            self.guard.set_arm(False)
        return f"the box did not confirm within {timeout:g} s ({flag_names(self.flags)})"

    def warm_up(self) -> FloatArray:
        """Compile everything before the deadlines begin; return the first measurement. Repeated calls cost nothing."""
        begin = time.monotonic()
        self._box.receive(Command(), 0.0)
        self._box.tick(self._plant.reset(self.settings.seed), 0.0)
        self._plant.step(0.0)
        self._box.reset()
        taken = time.monotonic() - begin
        if taken > 1.0:
            self._log(f"compiled in {taken:.1f} s; the next start takes it from numba's cache")
        return self._plant.reset(self.settings.seed)

    def _stamp(self) -> int:
        """Stamp [ns] of the present sample: ROS time at speed 1, else the simulation's own."""
        if not self.real_time:
            return self.samples * round(1e9 * SAMPLE_PERIOD)
        step = self.host_clock.look()
        if step:
            self._log(clock_step_message(step))
        return self.host_clock.ros_time(self.pacer.deadline_ns)  # without the jitter of waking up

    def _wait(self, sequence: int, resend: Callable[[], None]) -> None:
        if self.settings.speed > 0.0 or not self.steps.engaged:
            self.pacer.wait()
        else:
            self.steps.wait(sequence, bool(self.flags & Flag.ARMED), resend)
            self.pacer.restart()

    def _note_flags(self, flags: int) -> None:
        changed, self.flags = flags ^ self.flags, flags
        if changed & Flag.TRIPPED and flags & Flag.TRIPPED:
            self._log(f"tripped: {flag_names(flags)}")
        if changed:
            with self._confirmed:
                self._confirmed.notify_all()
