# SPDX-License-Identifier: Apache-2.0
"""The simulation behind the sim node and its pace, with peers in another thread and without ROS."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from hydro_bridge.plant_clock import COMMANDER_WINDOW, FILTER_WINDOW, LockStep, LockStepSettings
from hydro_bridge.safety.guard import CommandGuard
from hydro_core.signals import STATE_FIELDS, CorrectionStatus, Flag, ReferenceSignal, Waveform
from hydro_sim.box.box import Box
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.realtime import SimSettings, Simulation
from hydro_sim.timer import PeriodicTimer
from tests.checks import wait

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=2.0)
VALVE, NOMINAL, K_P = (
    2 + STATE_FIELDS.index(name) for name in ("valve_current", "nominal_valve_current", "proportional_gain")
)


class Graph:
    """A running simulation, and whoever else: `answer` is called in a thread of its own with each sample's number."""

    def __init__(self, answer: Callable[[Graph, int], None], peers: str = "", **settings: Any) -> None:
        bench, self.guard = Bench.nominal(), CommandGuard()
        self.lock_step = LockStep(LockStepSettings(peers=peers), print)
        self.samples: list[tuple[Any, ...]] = []
        self.stamps: list[int] = []
        self._inbox: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._answer = answer
        self.guard.set_reference(SINE)
        self.simulation = Simulation(
            Box(bench), AnalyticPlant(bench), self.guard, SimSettings(**settings), self._on_state, print, self.lock_step
        )
        for name in peers.split():
            self.lock_step.on_answer(name, None, {"filter": FILTER_WINDOW, "trainer": COMMANDER_WINDOW}[name])
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._peer, self.simulation.run)]

    def _on_state(self, stamp: int, fields: tuple[Any, ...]) -> None:
        self.samples.append(fields)
        self.stamps.append(stamp)
        self._inbox.put(fields[1])

    def _peer(self) -> None:
        while (sequence := self._inbox.get()) is not None:
            self._answer(self, sequence)

    def wait_for(self, samples: int) -> None:
        """On a fresh machine it compiles first."""
        wait(lambda: len(self.samples) >= samples, 150.0)

    def __enter__(self) -> Graph:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.simulation.stop()
        self._inbox.put(None)
        for thread in self._threads:
            thread.join(30.0)
            assert not thread.is_alive()


def test_under_its_own_clock_each_sample_carries_the_correction_of_the_one_before() -> None:
    def dither(sequence: int) -> float:
        return 1e-4 * (sequence % 7 - 3)

    def answer(graph: Graph, sequence: int) -> None:
        if sequence % 50 == 0:
            time.sleep(0.03)  # a slow filter slows the simulation, and nothing is lost
        with graph.simulation.lock:
            now = graph.simulation.now()
            if sequence % 10 == 0:
                graph.guard.set_gains(float(sequence // 10 % 70), 0.0, now)
            graph.guard.set_correction(dither(sequence), CorrectionStatus.PASS, sequence, now)
        if sequence % 10 == 0:
            graph.lock_step.on_answer("trainer", sequence, COMMANDER_WINDOW)
        graph.lock_step.on_correction(sequence)

    with Graph(answer, peers="filter trainer") as graph:
        graph.wait_for(30)
        assert graph.simulation.arm(True) == ""
        graph.wait_for(600)
    samples = [fields for fields in graph.samples[:600] if fields[-1] == Flag.ARMED | Flag.PACED]
    assert len(samples) > 400
    assert [fields[1] for fields in graph.samples[:600]] == list(range(600))
    for fields in samples[12:]:
        sequence = fields[1]
        assert fields[VALVE] == fields[NOMINAL] + dither(sequence - 1)
        assert fields[K_P] == 15.0 + (sequence - 1) // 10 % 70, sequence
    assert graph.stamps[:600] == [1_000_000 * k for k in range(600)]


def test_at_a_factor_of_real_time_nobody_is_waited_for_and_time_is_the_simulations() -> None:
    with Graph(lambda *_: None, pace="4") as graph:
        graph.wait_for(400)
        assert time.monotonic() - graph.simulation.began > 0.09
    assert all(fields[-1] & Flag.PACED for fields in graph.samples)
    assert graph.stamps[:400] == [1_000_000 * k for k in range(400)]


def test_time_away_is_left_out_and_a_short_delay_is_caught_up_on() -> None:
    timer = PeriodicTimer(1e-3, catch_up_max=2.0)  # longer than a busy machine keeps a thread waiting
    start = timer.deadline_ns
    time.sleep(0.02)
    for _ in range(30):
        timer.wait()
    assert timer.deadline_ns == start + 30_000_000 and timer.skipped == 0.0 and timer.late >= 15
    timer = PeriodicTimer(1e-3, catch_up_max=0.05)
    time.sleep(0.1)
    before = time.monotonic_ns()
    timer.wait()
    assert timer.skipped >= 0.09
    assert before - 1_000_000 <= timer.deadline_ns <= time.monotonic_ns() + 1_000_000
