# SPDX-License-Identifier: Apache-2.0
"""The simulation behind the sim node and its pace, with peers in other threads and without ROS."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.safety.pace import COMMANDER_WINDOW, FILTER_WINDOW, Pace, PaceSettings
from hydro_core.signals import STATE_FIELDS, CorrectionStatus, Flag, ReferenceSignal, Waveform
from hydro_sim.box.box import Box
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.realtime import SimSettings, Simulation
from tests.checks import wait

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=2.0)
VALVE, NOMINAL, K_P = (
    2 + STATE_FIELDS.index(name) for name in ("valve_current", "nominal_valve_current", "proportional_gain")
)


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    """Before any thread is waited for: on a fresh machine it takes longer than that, and is told of as a sentence."""
    bench, nobody = Bench.nominal(), lambda *heard: None
    still = Simulation(Box(bench), AnalyticPlant(bench), CommandGuard(), SimSettings(), nobody, nobody)
    still.stop()
    still.run()


class Graph:
    """A simulation, and whoever else: `answer` is called in a thread of its own with each sample."""

    def __init__(
        self, bench: Bench, answer: Callable[[Graph, tuple[Any, ...]], None], peers: str = "", **settings: Any
    ) -> None:
        self.samples: list[tuple[Any, ...]] = []
        self.stamps: list[int] = []
        self.said: list[str] = []
        self.inbox: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        self.answer = answer
        plant = AnalyticPlant(bench)
        self.guard = CommandGuard()
        self.guard.set_reference(SINE)
        self.pace = Pace(PaceSettings(peers=peers), self.said.append)
        self.simulation = Simulation(
            Box(bench), plant, self.guard, SimSettings(**settings), self._on_state, self.said.append, self.pace
        )
        for name in peers.split():
            self.pace.on_answer(name, None, {"filter": FILTER_WINDOW, "trainer": COMMANDER_WINDOW}[name])
        self.threads = [threading.Thread(target=target, daemon=True) for target in (self._peer, self.simulation.run)]
        for thread in self.threads:
            thread.start()

    def _on_state(self, stamp: int, fields: tuple[Any, ...]) -> None:
        self.samples.append(fields)
        self.stamps.append(stamp)
        self.inbox.put(fields)

    def _peer(self) -> None:
        while (fields := self.inbox.get()) is not None:
            self.answer(self, fields)

    def correct(self, fields: tuple[Any, ...], delta_u: float = 0.0) -> None:
        with self.simulation.lock:
            now = self.simulation.now()
            self.guard.set_correction(delta_u, CorrectionStatus.PASS, fields[1], now)
        self.pace.on_correction(fields[1])

    def gain(self, sequence: int, delta_kp: float) -> None:
        with self.simulation.lock:
            self.guard.set_gains(delta_kp, 0.0, self.simulation.now())
        self.pace.on_answer("trainer", sequence, COMMANDER_WINDOW)

    def close(self) -> None:
        self.simulation.stop()
        self.inbox.put(None)
        for thread in self.threads:
            thread.join(5.0)
            assert not thread.is_alive()


@pytest.fixture
def graph(bench: Bench) -> Iterator[Callable[..., Graph]]:
    made: list[Graph] = []

    def make(answer: Callable[[Graph, tuple[Any, ...]], None], **settings: Any) -> Graph:
        made.append(Graph(bench, answer, **settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


def dither(sequence: int) -> float:
    return 1e-4 * (sequence % 7 - 3)


def test_under_its_own_clock_each_sample_carries_the_correction_of_the_one_before(graph: Callable[..., Graph]) -> None:
    def answer(running: Graph, fields: tuple[Any, ...]) -> None:
        if fields[1] % 50 == 0:
            time.sleep(0.03)  # a slow filter slows the simulation, and nothing is lost
        if fields[1] % 10 == 0:
            running.gain(fields[1], float(fields[1] // 10 % 70))
        running.correct(fields, dither(fields[1]))

    running = graph(answer, peers="filter trainer")
    wait(lambda: len(running.samples) > 30, 20.0)
    assert running.simulation.arm(True) == ""
    wait(lambda: len(running.samples) > 600, 20.0)
    samples = [fields for fields in running.samples[:600] if fields[-1] == Flag.ARMED | Flag.PACED]
    assert len(samples) > 400
    assert [fields[1] for fields in running.samples[:600]] == list(range(600))
    for fields in samples[12:]:
        sequence = fields[1]
        assert fields[VALVE] == fields[NOMINAL] + dither(sequence - 1)
        assert fields[K_P] == 15.0 + (sequence - 1) // 10 % 70, sequence
    assert running.stamps[:600] == [1_000_000 * k for k in range(600)]


def test_at_a_factor_of_real_time_nobody_is_waited_for_and_time_is_the_simulations(graph: Callable[..., Graph]) -> None:
    running, began = graph(lambda *_: None, pace="4"), time.monotonic()
    wait(lambda: len(running.samples) >= 400, 20.0)
    assert time.monotonic() - began > 0.09
    assert all(fields[-1] & Flag.PACED for fields in running.samples)
    assert running.stamps[:400] == [1_000_000 * k for k in range(400)]


@pytest.mark.realtime
def test_real_time_stamps_are_a_millisecond_apart_and_commands_age_by_the_host(graph: Callable[..., Graph]) -> None:
    running = graph(lambda *_: None, pace="real")
    wait(lambda: len(running.samples) >= 300, 20.0)
    assert abs(running.simulation.now() - time.monotonic()) < 0.5
    steps = [later - earlier for earlier, later in zip(running.stamps, running.stamps[1:300], strict=False)]
    assert min(steps) == 1_000_000 and sorted(steps)[-3] == 1_000_000
    assert abs(1e-9 * running.stamps[-1] - time.time()) < 1.0
