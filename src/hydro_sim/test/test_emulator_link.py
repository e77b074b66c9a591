# SPDX-License-Identifier: Apache-2.0
"""The emulator's serial line: faults, pseudo-terminal, orders, and the whole of it in real time with a real reader."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.serial.protocol import Hello, State
from hydro_bridge.serial.stream import Decoder
from hydro_bridge.settings import SettingsError
from hydro_sim.box.box import EMULATED_BOX, BoxConfig, box_info
from hydro_sim.emulator.line.faults import FaultyLine, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.realtime import execute
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
    with pytest.raises(SettingsError, match="exists and is not a link"):
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
