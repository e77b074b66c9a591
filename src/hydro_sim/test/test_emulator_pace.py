# SPDX-License-Identifier: Apache-2.0
"""The emulated box at the pace of its host: who greets, answers, sends its own time, is silent, or leaves."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hydro_bridge.serial.port import Port, PortSettings
from hydro_bridge.serial.protocol import ClockFrame, Frame, Hello, State, encode_clock, encode_command, encode_hello
from hydro_bridge.serial.stream import Decoder
from hydro_core.signals import Command
from hydro_sim.emulator import realtime
from hydro_sim.emulator.line.faults import LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.realtime import RealtimeEmulator
from hydro_sim.emulator.truth.config import profile
from tests.checks import wait


class Host:
    """A host at the port of a running emulator."""

    def __init__(self, folder: Path, faults: LinkFaults) -> None:
        machine = Machine(profile("nominal"))
        machine.warm_up()
        self.link = BoxLink(Terminal(folder / "port"), machine.box, faults)
        self.running = RealtimeEmulator(machine, self.link, None)
        self._stopped, self._sequence, self._decoder = False, 0, Decoder()
        self._thread = threading.Thread(target=self.running.run, args=(None, lambda: self._stopped), daemon=True)
        self._thread.start()
        self.port = Port(PortSettings(path=str(folder / "port")))
        self.port.open()

    def greet(self, *, follows: bool = True) -> None:
        self.port.write(encode_hello(0, 0, follows=follows))

    def read(self) -> list[Frame]:
        """What has come, up to a sample, however long a busy machine takes; nothing if none comes in 10 s."""
        frames, end = list[Frame](), time.monotonic() + 10.0
        while not any(isinstance(frame, State) for frame in frames) and time.monotonic() < end:
            frames += self._decoder.feed(self.port.read(0.5))
        return frames

    def answer(self, time_us: int) -> None:
        self._sequence += 1
        self.port.write(encode_command(self._sequence, time_us, Command()))

    def stands(self) -> bool:
        time.sleep(0.05)  # a sample is counted after it is sent
        before = self.running.samples
        time.sleep(0.1)
        return self.running.samples == before

    def close(self) -> None:
        self._stopped = True
        self._thread.join(5.0)
        self.port.close()
        self.link.terminal.unplug()
        assert not self._thread.is_alive()


@pytest.fixture
def host(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Host]:
    made = Host(tmp_path, getattr(request, "param", LinkFaults()))
    yield made
    made.close()


def test_it_stands_still_until_a_host_greets_and_gives_a_sample_for_each_answer(host: Host) -> None:
    assert host.stands() and host.running.samples == 0
    host.greet()
    clock, hello, *_, state = host.read()
    assert isinstance(clock, ClockFrame) and clock.waits and isinstance(hello, Hello)
    for sequence in range(300):
        assert isinstance(state, State) and (state.sequence, state.time_us) == (sequence, 1000 * sequence)
        host.answer(state.time_us)
        (state,) = host.read()
    assert host.stands()


def test_a_greeting_that_is_repeated_takes_no_sample(host: Host) -> None:
    for _ in range(3):
        host.greet()
        assert host.read()[-1].sequence == 0
    host.answer(0)
    wait(lambda: host.running.samples == 2, 20.0)
    assert host.stands()


def test_a_host_that_does_not_say_that_it_answers_is_served_in_real_time(host: Host) -> None:
    host.greet(follows=False)
    host.read()
    began, before = time.monotonic(), host.running.samples
    wait(lambda: host.running.samples >= before + 200, 20.0)
    assert time.monotonic() - began > 0.19


def test_a_silent_host_counts_as_dead_until_it_answers(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "SILENCE_MAX", 2.0)
    host.greet()
    host.read()
    host.answer(0)
    (state,) = host.read()
    for _ in range(12):  # its graph is at work
        host.port.write(encode_clock(state.time_us, waits=True))
        time.sleep(0.2)
    assert host.running.samples == 2
    wait(lambda: host.running.samples > 50, 20.0)

    def answers() -> bool:
        for frame in host.read():
            host.answer(frame.time_us)
        return not host.running._deserted

    wait(answers, 20.0)
    wait(host.stands, 20.0)


def test_without_a_host_time_goes_on(host: Host) -> None:
    host.greet()
    host.read()
    host.port.close()
    wait(lambda: host.running.samples > 250, 20.0)


@pytest.mark.parametrize("host", [LinkFaults(drop=1.0)], indirect=True)
def test_an_answer_that_the_line_loses_is_not_waited_for(host: Host) -> None:
    host.link.set_faults(LinkFaults())
    host.greet()
    host.read()
    host.answer(0)
    host.link.set_faults(LinkFaults(drop=1.0))
    wait(lambda: host.running.samples > 20, 20.0)
