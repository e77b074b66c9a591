# SPDX-License-Identifier: Apache-2.0
"""Simulation of box and plant at a pace, without ROS: the core of the sim node.

One thread runs `run`, a sample at a time: poll the guard, tick the box, hand over the sample, step the plant, wait.
Other threads set the guard's commands (under `lock`), `arm`, and report answers to `lock_step`. The bridge's `Link` is
its counterpart.

======== ==========================================================================================================
pace     when the next sample follows, and the clock on which commands age
======== ==========================================================================================================
plant    once the graph has answered the last one (`hydro_bridge.plant_clock`); the simulation's
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

from hydro_bridge.plant_clock import LockStep, parse_pace
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.safety.plant_interface import PlantInterface
from hydro_bridge.serial.protocol import LawState
from hydro_core.settings import check, described, quantity
from hydro_core.signals import SAMPLE_PERIOD, STATE_DTYPE, Command, Flag, FloatArray, flag_names
from hydro_sim.box.box import Box, law_state
from hydro_sim.model.plant import Plant
from hydro_sim.timer import PeriodicTimer, disable_timer_slack

_NOMINAL_CURRENT_COLUMN = (STATE_DTYPE.names or ()).index("nominal_valve_current")


@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """Settings of the sim node."""

    model: Annotated[
        str, described("Bench file, `shipped` or `analytic`; empty: `analytic` with `bench`, else `shipped`")
    ] = ""
    bench: Annotated[str, described("bench.yaml or a diagnosis' corrected.yaml; empty: the shipped one")] = ""
    box_bench: Annotated[str, described("bench.yaml that the box's force law believes; empty: `bench`")] = ""
    pace: Annotated[
        str, described("`plant`: samples wait for the graph's answers; `real`; or a number of times real time")
    ] = "plant"
    noise: Annotated[float, quantity("-", 0.0, 100.0, "Scale of the sensors' noise and quantisation")] = 1.0
    seed: Annotated[int, quantity("-", 0, 4294967295, "Seed of the noise")] = 0

    def __post_init__(self) -> None:
        check(self)
        parse_pace(self.pace)


class Simulation(PlantInterface):
    """A running simulation.

    `box`, `plant`: the parts; `run` alone touches them. `settings`: pace and seed. `on_state`: called in the thread of
    `run` with each sample's stamp [ns], ROS time in real time, else the simulation's own, and with its record as a
    tuple in the order of STATE_DTYPE. `guard`, `log`, `lock_step`: see `PlantInterface`.
    """

    def __init__(
        self, box: Box, plant: Plant, guard: CommandGuard, settings: SimSettings,
        on_state: Callable[[int, tuple[Any, ...]], None], log: Callable[[str], None], lock_step: LockStep | None = None,
    ) -> None:  # fmt: skip
        super().__init__(guard, log, lock_step=lock_step)
        self.settings, self._answered = settings, threading.Event()
        self.lock_step.on_release = self._answered.set
        self._factor = parse_pace(settings.pace)
        self.timer = PeriodicTimer(SAMPLE_PERIOD / (self._factor or 1.0))
        self._box, self._plant, self._on_state = box, plant, on_state
        self._stopping = threading.Event()
        self.began = time.monotonic()

    @property
    def law_state(self) -> LawState | None:
        """State of the force law in the present sample, for `on_state`; None: the paper's law."""
        state = self._box.state[0]
        return law_state(state) if state["acting"]["law"] else None

    @property
    def real_time(self) -> bool:
        """Whether stamps are ROS time, and commands age by the host's clock."""
        return self._factor == 1.0

    @property
    def paced(self) -> bool:
        """Whether each sample waits for answers."""
        return self._factor is None

    def now(self) -> float:
        """Time [s] by which commands and leases age: the host's monotonic clock, or the simulation's own."""
        return time.monotonic() if self.real_time else self.samples * SAMPLE_PERIOD

    def run(self) -> None:
        """Simulate until `stop`; the body of the plant's thread."""
        disable_timer_slack()
        measurement = self.warm_up()
        if self.paced:
            self.lock_step.wait_for_peers()
        self.began = time.monotonic()
        self.timer.restart()
        while not self._stopping.is_set():
            now = self.samples * SAMPLE_PERIOD
            with self.lock:
                command = self.guard.command(self.now())
            self._box.receive(command, now)
            sample = self._box.tick(measurement, now)
            stamp = self.samples * round(1e9 * SAMPLE_PERIOD)
            if self.real_time:
                stamp = self._ros_time(self.timer.deadline_ns)  # without the jitter of waking up
            fields: tuple[Any, ...] = sample.item()  # type: ignore[assignment]
            if not self.real_time:
                fields = (*fields[:-1], fields[-1] | Flag.PACED)
            with self.lock:
                self.guard.add_sample(fields[1], fields[_NOMINAL_CURRENT_COLUMN])
            if fields[-1] & ~self.flags & Flag.TRIPPED:
                self._log(f"tripped: {flag_names(fields[-1])}")
            self._update_flags(fields[-1])
            publish = partial(self._on_state, stamp, fields)
            if self.paced:
                self._answered.clear()
                self.lock_step.begin_sample(fields[1], publish)
            publish()
            measurement = self._plant.step(fields[10])
            if self.paced:
                while not self._answered.is_set():
                    self._answered.wait(self.lock_step.poll())
            else:
                self.timer.wait()
            self.samples += 1

    def stop(self) -> None:
        """End `run`."""
        self._stopping.set()
        self.lock_step.close()

    def send(self, corrected: int | None = None) -> None:
        """Release the pending sample for a command without a correction; others apply with the next sample."""
        if corrected is None:
            self.lock_step.release()

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
