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

    def __init__(self, folder: Path) -> None:
        machine = Machine(profile("nominal"))
        machine.warm_up()
        self.link = BoxLink(Terminal(folder / "port"), machine.box, LinkFaults())
        self.running = RealtimeEmulator(machine, self.link, None)
        self._stopped, self._sequence, self._decoder = False, 0, Decoder()
        self._thread = threading.Thread(target=self.running.run, args=(None, lambda: self._stopped), daemon=True)
        self._thread.start()
        self.port = Port(PortSettings(path=str(folder / "port")))
        self.port.open()

    def greet(self, *, follows: bool = True) -> list[Frame]:
        """What comes back."""
        self.port.write(encode_hello(0, 0, lock_step=follows))
        return self.read()

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

    def goes_on(self, samples: int) -> None:
        """Wait until it has taken so many more."""
        before = self.running.samples
        wait(lambda: self.running.samples >= before + samples, 20.0)

    def close(self) -> None:
        self._stopped = True
        self._thread.join(30.0)
        self.port.close()
        self.link.terminal.unplug()
        assert not self._thread.is_alive()


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Host]:
    made = Host(tmp_path)
    yield made
    made.close()


def test_it_stands_still_until_a_host_greets_and_gives_a_sample_for_each_answer(host: Host) -> None:
    """A greeting that is repeated takes none."""
    assert host.stands() and host.running.samples == 0
    clock, hello, *_, state = host.greet()
    assert isinstance(clock, ClockFrame) and clock.waits and isinstance(hello, Hello)
    for _ in range(2):
        *_, state = host.greet()
    for sequence in range(300):
        assert isinstance(state, State) and (state.sequence, state.time_us) == (sequence, 1000 * sequence)
        host.answer(state.time_us)
        *_, state = host.read()
    assert host.stands()


def test_a_host_that_does_not_say_that_it_answers_is_served_in_real_time(host: Host) -> None:
    host.greet(follows=False)
    began = time.monotonic()
    host.goes_on(200)
    assert time.monotonic() - began > 0.19


def test_a_silent_host_counts_as_dead_until_it_answers(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "SILENCE_MAX", 2.0)
    host.greet()
    host.answer(0)
    (state,) = host.read()
    for _ in range(12):  # its graph is at work
        host.port.write(encode_clock(state.time_us, waits=True))
        time.sleep(0.2)
    assert host.running.samples == 2
    host.goes_on(50)

    def answers() -> bool:
        for frame in host.read():
            host.answer(frame.time_us)
        return not host.running._deserted

    wait(answers, 20.0)
    wait(host.stands, 20.0)


def test_without_a_host_time_goes_on(host: Host) -> None:
    host.greet()
    host.port.close()
    host.goes_on(250)


def test_an_answer_that_the_line_loses_is_not_waited_for(host: Host) -> None:
    host.greet()
    host.answer(0)
    host.link.set_faults(LinkFaults(drop=1.0))
    host.goes_on(20)
