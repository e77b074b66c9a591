# SPDX-License-Identifier: Apache-2.0
"""The emulator's serial line: faults, pseudo-terminal, orders, and the whole of it in real time with a real reader."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.serial.protocol import Hello, State, encode_command, encode_hello
from hydro_bridge.serial.stream import Decoder, SequenceTracker
from hydro_bridge.settings import SettingsError
from hydro_bridge.signals import Command, Flag, ReferenceSignal, Waveform
from hydro_sim.box.box import EMULATED_BOX, BoxConfig, box_info
from hydro_sim.emulator.control import ControlPipe, execute
from hydro_sim.emulator.line.faults import FaultyLine, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.config import profile
from hydro_sim.model.bench import Bench

FRAMES = [bytes([0, *([1 + k % 200] * 20), 0]) for k in range(2000)]


def carried(seed: int = 0, **chances: float) -> tuple[list[bytes], FaultyLine]:
    line = FaultyLine(LinkFaults(**chances), np.random.default_rng(seed))  # type: ignore[arg-type]
    return [line.carry(frame, 0.0) for frame in FRAMES], line


@pytest.mark.parametrize(
    ("name", "length"),
    [("corrupt", 22), ("lose", 21), ("drop", 0), ("duplicate", 44)],
)
def test_fault_does_what_it_says_as_often_as_it_says(name: str, length: int) -> None:
    out, line = carried(**{name: 0.2})
    hit = [after for before, after in zip(FRAMES, out, strict=True) if after != before]
    assert len(hit) == pytest.approx(400, abs=60)
    assert line.counts[name] == pytest.approx(len(hit), abs=5)  # two flips of one bit may cancel
    assert all(len(after) == length for after in hit)


def test_reordering_swaps_neighbours_and_loses_nothing() -> None:
    out, line = carried(reorder=0.3)
    joined = b"".join(out)
    assert line.counts["reorder"] > 300
    assert sorted(joined) == sorted(b"".join(FRAMES[: len(joined) // 22]))
    first = next(k for k, after in enumerate(out) if not after)
    assert out[first + 1] == FRAMES[first + 1] + FRAMES[first]


def test_stall_holds_everything_back_and_then_lets_it_go_in_order() -> None:
    line = FaultyLine(LinkFaults(), np.random.default_rng(0))
    line.stall(0.5)
    assert [line.carry(frame, 0.1 * k) for k, frame in enumerate(FRAMES[:5])] == [b""] * 5
    assert line.carry(FRAMES[5], 0.5) == b"".join(FRAMES[:6])


@pytest.fixture
def link(tmp_path: Path) -> Iterator[BoxLink]:
    made = BoxLink(Terminal(tmp_path / "port"), box_info(Bench.nominal(), BoxConfig(), EMULATED_BOX), LinkFaults())
    yield made
    made.terminal.unplug()


@pytest.fixture(scope="module")
def machine() -> Machine:
    return Machine(profile("default"))


def opened(link: BoxLink) -> Port:
    port = Port(PortSettings(path=str(link.terminal.path)))
    port.open()
    return port


def test_nobody_listening_costs_nothing_and_leaves_nothing_stale(link: BoxLink, machine: Machine) -> None:
    for _ in range(200):
        link.send(machine.tick(), 0.0)
    assert (link.report.unheard, link.report.sent) == (200, 0)
    port = opened(link)
    link.send(machine.tick(), 0.0)
    hello, state = Decoder().feed(port.read(1.0))
    assert isinstance(hello, Hello) and hello.info is not None and hello.info.delta_u_max == pytest.approx(0.1)
    assert isinstance(state, State) and state.sequence >= 200
    port.close()


def test_a_reader_that_does_not_read_loses_whole_frames_only(link: BoxLink, machine: Machine) -> None:
    port = opened(link)
    for _ in range(2000):
        link.send(machine.tick(), 0.0)
    assert link.report.blocked > 1000
    decoder = Decoder()
    for _ in range(20):
        decoder.feed(port.read(0.05))
        link.send(machine.tick(), 0.0)
    while piece := port.read(0.2):
        decoder.feed(piece)
    assert decoder.counts.crc_errors == decoder.counts.malformed == 0
    assert decoder.counts.frames == link.report.sent + 1
    port.close()


def test_unplugging_hangs_up_and_replugging_comes_back_behind_the_same_name(link: BoxLink, machine: Machine) -> None:
    port = opened(link)
    link.unplug(2.0, now=10.0)
    assert not link.terminal.path.exists()
    with pytest.raises(PortLostError):
        port.read(0.5)
    link.poll(11.9)
    assert not link.terminal.plugged
    link.poll(12.0)
    again = opened(link)
    link.send(machine.tick(), 12.0)
    assert again.read(1.0)
    again.close()


def test_a_place_taken_by_a_file_is_refused_and_the_file_kept(tmp_path: Path) -> None:
    (tmp_path / "port").write_text("precious")
    with pytest.raises(SettingsError, match="exists and is no link"):
        Terminal(tmp_path / "port")
    assert (tmp_path / "port").read_text() == "precious"


def test_orders_are_obeyed_or_refused_in_one_sentence(link: BoxLink, machine: Machine) -> None:
    execute("corrupt 0.25", machine, link, 0.0)
    execute("duplicate 0.5", machine, link, 0.0)
    assert link.up.faults == link.down.faults == LinkFaults(corrupt=0.25, duplicate=0.5)
    execute("clear", machine, link, 0.0)
    assert link.up.faults == LinkFaults()
    machine.tick()
    execute("reboot", machine, link, 0.0)
    assert machine.time == 0.0 and int(machine.tick()["sequence"]) == 0
    for order in ("", "melt", "corrupt", "corrupt 2", "corrupt x", "clear 1", "unplug -1"):
        with pytest.raises(SettingsError, match="order"):
            execute(order, machine, link, 0.0)


def test_orders_come_through_the_pipe_line_by_line(tmp_path: Path) -> None:
    pipe = ControlPipe(tmp_path / "control")
    writer = os.open(tmp_path / "control", os.O_WRONLY)
    os.write(writer, b"stall 0.1\nunpl")
    assert list(pipe.lines()) == ["stall 0.1"]
    os.write(writer, b"ug 2\n")
    assert list(pipe.lines()) == ["unplug 2"]
    assert list(pipe.lines()) == []
    os.close(writer)
    pipe.close()
    assert not (tmp_path / "control").exists()


@dataclass
class Listener:
    """What a reader of the running emulator saw."""

    decoder: Decoder = field(default_factory=Decoder)
    states: list[State] = field(default_factory=list)
    lost: int = 0  # connections

    def __post_init__(self) -> None:
        self.tracker = SequenceTracker(self.decoder.counts)

    def listen(self, path: Path, seconds: float) -> None:
        """Read and command at 1 kHz, open again when the port goes away."""
        port = Port(PortSettings(path=str(path)))
        end, connected, sent = time.monotonic() + seconds, False, 0
        wanted = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
        while time.monotonic() < end:
            try:
                if not connected:
                    port.open()
                    port.write(encode_hello(1, 0))
                    self.decoder.reset()
                    connected, sent = True, 0
                for frame in self.decoder.feed(port.read(0.1)):
                    if isinstance(frame, State) and self.tracker.accept(frame.sequence):
                        self.states.append(frame)
                        sent += 1
                        command = Command(arm=sent > 20, delta_kp=75.0, delta_ki=10.0, reference=wanted)
                        port.write(encode_command(sent, 0, command))
            except PortLostError:
                self.lost += connected
                connected = False
                time.sleep(0.02)
        port.close()


@contextlib.contextmanager
def running(folder: Path, *words: str) -> Iterator[tuple[Path, list[str]]]:
    """The emulator as a process of its own; gives the port and, once it has ended, its last words."""
    port = folder / "port"
    command = [sys.executable, "-m", "hydro_sim.emulator.command", "--link", str(port), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    last_words: list[str] = []
    try:
        assert process.stdout is not None and str(port) in process.stdout.readline()
        yield port, last_words
        process.send_signal(signal.SIGINT)
        last_words += process.communicate(timeout=20)[0].splitlines()
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait()


@pytest.mark.graph
def test_a_reader_gets_every_sample_of_the_running_emulator(tmp_path: Path) -> None:
    listener = Listener()
    with running(tmp_path, "--noise-free", str(tmp_path / "free.npz")) as (port, last_words):
        listener.listen(port, 3.0)
    sequences = np.array([state.sequence for state in listener.states])
    assert np.array_equal(np.diff(sequences), np.ones(len(sequences) - 1))
    assert len(sequences) == pytest.approx(3000, abs=100)
    assert (listener.decoder.counts.crc_errors, listener.decoder.counts.malformed) == (0, 0)
    assert listener.states[-1].flags & Flag.ARMED
    times = np.array([state.time_us for state in listener.states])
    assert np.array_equal(times, 1000 * sequences)
    with np.load(tmp_path / "free.npz") as free:
        log = free["noise_free"][sequences]
    measured = np.array([state.values[2] for state in listener.states])
    assert np.std(measured - log["load_force"]) == pytest.approx(0.6, rel=0.1)
    assert "late" in last_words[0] and "commands taken" in last_words[1]
    assert not port.exists()


@pytest.mark.graph
def test_a_reader_survives_a_faulty_line_and_a_replug(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "corrupt: 0.02\ndrop: 0.02\nduplicate: 0.02\nreorder: 0.02\nnoise: 0.02\nevents: [{at: 2, unplug: 1}]\n"
    )
    control = tmp_path / "control"
    listener = Listener()
    with running(tmp_path, "--faults", str(faults), "--control", str(control), "--seed", "3") as (port, last_words):
        listener.listen(port, 4.0)
        control.write_text("clear\n")
        for _ in range(10):  # whenever the emulator reads its orders
            cleared = Listener()
            cleared.listen(port, 0.5)
            if not (cleared.decoder.counts.crc_errors or cleared.decoder.counts.lost):
                break
    counts = listener.decoder.counts
    assert listener.lost == 1
    assert min(counts.crc_errors, counts.lost, counts.duplicates, counts.reordered) > 5
    assert len(listener.states) > 2000
    assert all(abs(state.values[2]) < 1000.0 and np.isfinite(state.values).all() for state in listener.states)
    assert cleared.decoder.counts.crc_errors == cleared.decoder.counts.lost == 0
    assert len(cleared.states) > 300
    assert "faults made" in last_words[1]
