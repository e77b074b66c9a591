# SPDX-License-Identifier: Apache-2.0
"""Simulation of box and plant at a pace, without ROS: the core of the sim node.

One thread runs `run`, a sample at a time: ask the guard, tick the box, hand the sample on, step the plant, wait. Other
threads tell the guard what is wanted (under `lock`), `arm`, and report answers to `pace`. The bridge's `Link` is its
counterpart.

======== ==========================================================================================================
pace     when the next sample follows, and the clock on which commands age
======== ==========================================================================================================
plant    once the graph has answered the last one (`hydro_bridge.safety.pace`); the simulation's
real     a millisecond later; the host's
number   that many simulated seconds per second; the simulation's
======== ==========================================================================================================
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.safety.pace import Pace, PaceSettings, parse_pace
from hydro_bridge.serial.protocol import LawState
from hydro_core.clock import HostClock, clock_step_message
from hydro_core.process.realtime import Pacer, disable_timer_slack
from hydro_core.settings import check, quantity
from hydro_core.signals import SAMPLE_PERIOD, STATE_DTYPE, Command, Flag, FloatArray, flag_names
from hydro_sim.box.box import Box, law_state
from hydro_sim.model.plant import Plant

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
    pace: str = "plant"
    """`plant`: each sample waits for the graph's answers; `real`: real time; a number: that many times real time."""
    noise: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0
    """Scale of the sensors' noise and quantisation."""
    seed: Annotated[int, quantity("-", 0, 4294967295)] = 0
    """Seed of the noise."""

    def __post_init__(self) -> None:
        check(self)
        parse_pace(self.pace)


class Simulation:
    """A running simulation.

    Parameters
    ----------
    box, plant, guard
        The parts; `run` alone touches box and plant.
    settings
        Pace and seed.
    on_state
        Called in the thread of `run` with each sample's stamp [ns], ROS time in real time, else the simulation's own,
        and with its record as a tuple in the order of STATE_DTYPE.
    log
        Called with a sentence when something changes.
    pace
        Knows whose answers each sample waits for.
    """

    def __init__(
        self,
        box: Box,
        plant: Plant,
        guard: CommandGuard,
        settings: SimSettings,
        on_state: Callable[[int, tuple[Any, ...]], None],
        log: Callable[[str], None],
        pace: Pace | None = None,
    ) -> None:
        self.guard, self.settings = guard, settings
        self.lock = threading.Lock()
        self.pace, self._answered = pace or Pace(PaceSettings(), log), threading.Event()
        self.pace.go_on = self._answered.set
        factor = parse_pace(settings.pace)
        self.paced, self.real_time = factor is None, factor == 1.0
        """Whether each sample waits for answers; whether stamps are ROS time and commands age by the host's clock."""
        self.pacer = Pacer(SAMPLE_PERIOD / (factor or 1.0))
        self.host_clock = HostClock()
        self.samples = 0
        self.flags = 0
        self._box, self._plant = box, plant
        self._on_state, self._log = on_state, log
        self._stopping = threading.Event()
        self._confirmed = threading.Condition()
        self._began = time.monotonic()

    @property
    def law_state(self) -> LawState | None:
        """State of the force law in the present sample, for `on_state`; None: the paper's law."""
        state = self._box.state[0]
        return law_state(state) if state["acting"]["law"] else None

    def now(self) -> float:
        """Time [s] by which commands and leases age: the host's monotonic clock, or the simulation's own."""
        return time.monotonic() if self.real_time else self.samples * SAMPLE_PERIOD

    def mean_speed(self) -> float:
        """Return the simulated seconds per second of wall clock since the start."""
        return self.samples * SAMPLE_PERIOD / max(time.monotonic() - self._began, SAMPLE_PERIOD)

    def run(self) -> None:
        """Simulate until `stop`; the body of the plant's thread."""
        disable_timer_slack()
        measurement = self.warm_up()
        if self.paced:
            self.pace.wait_for_peers()
        self._began = time.monotonic()
        self.pacer.restart()
        while not self._stopping.is_set():
            now = self.samples * SAMPLE_PERIOD
            with self.lock:
                command = self.guard.command(self.now())
            self._box.receive(command, now)
            sample = self._box.tick(measurement, now)
            stamp = self._stamp()
            fields: tuple[Any, ...] = sample.item()  # type: ignore[assignment]
            if not self.real_time:
                fields = (*fields[:-1], fields[-1] | Flag.PACED)
            with self.lock:
                self.guard.note_sample(fields[1], fields[_NOMINAL])
            changed, self.flags = fields[-1] ^ self.flags, fields[-1]
            if changed & self.flags & Flag.TRIPPED:
                self._log(f"tripped: {flag_names(self.flags)}")
            if changed:
                with self._confirmed:
                    self._confirmed.notify_all()
            publish = partial(self._on_state, stamp, fields)
            if self.paced:
                self._answered.clear()
                self.pace.begin_sample(fields[1], publish)
            publish()
            measurement = self._plant.step(fields[10])
            if self.paced:
                while not self._answered.is_set():
                    self._answered.wait(self.pace.poll())
            else:
                self.pacer.wait()
            self.samples += 1

    def stop(self) -> None:
        """End `run`."""
        self._stopping.set()
        self.pace.close()

    def send(self, corrects: int | None = None) -> None:
        """Apply a command that corrects nothing at once; others apply with the next sample."""
        if corrects is None:
            self.pace.release()

    def arm(self, arm: bool, timeout: float = 0.5) -> str:
        """Arm or disarm and wait for the box to confirm; return why not, or nothing. Not for the thread of `run`."""
        with self.lock:
            if arm and self.flags & Flag.TRIPPED:
                return f"the box has tripped ({flag_names(self.flags)}): disarm it, then arm it"
            self.guard.set_arm(arm)

        def done() -> bool:
            return bool(self.flags & Flag.ARMED) == arm

        if self.paced:
            confirmed = self.pace.run_until(done)
        else:
            with self._confirmed:
                confirmed = self._confirmed.wait_for(done, timeout)
        if confirmed:
            return ""
        with self.lock:
            self.guard.set_arm(False)
        return f"the box did not confirm within {timeout:g} s ({flag_names(self.flags)})"

    def warm_up(self) -> FloatArray:
        """Compile all kernels before deadlines begin; return the first measurement. Repeated calls cost nothing."""
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
        """Stamp [ns] of the present sample: ROS time in real time, else the simulation's own."""
        if not self.real_time:
            return self.samples * round(1e9 * SAMPLE_PERIOD)
        step = self.host_clock.detect_step()
        if step:
            self._log(clock_step_message(step))
        return self.host_clock.ros_time(self.pacer.deadline_ns)  # without the jitter of waking up
