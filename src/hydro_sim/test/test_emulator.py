# SPDX-License-Identifier: Apache-2.0
"""The emulator: the truth's YAML, recordings offline, and the box's end of the line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.serial.protocol import Details, Hello, LawFrame, State
from hydro_bridge.serial.stream import Decoder
from hydro_core.settings import SettingsError
from hydro_core.signals import STATE_DTYPE, Command, StateArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.command import main
from hydro_sim.emulator.line.faults import FAULT_NAMES, FaultyLine, LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import load_truth_config, record_offline
from hydro_sim.emulator.realtime import execute_command
from hydro_sim.emulator.truth.config import profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.checks import status_of


def test_the_emulated_bench_is_the_box_s_where_the_truth_does_not_say_otherwise(tmp_path: Path) -> None:
    own = replace(Bench.nominal(), piston_area=1e-3, moving_mass=9.0, load_cell_bandwidth=None)
    file = tmp_path / "truth.yaml"
    file.write_text("profile: nominal\nbench: {moving_mass: 8}\n")
    emulated = vars(load_truth_config(str(file), own).bench)
    assert {name: emulated[name] for name in own.to_mapping()} == own.to_mapping() | {"moving_mass": 8.0}
    assert emulated["load_cell_bandwidth"] is None
    assert load_truth_config(None, own).bench.piston_area == 1e-3
    assert load_truth_config(None, Bench.nominal()) == profile("default")


REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"effect": {}}, "truth.effect is not a known setting; did you mean effects?"),
    ({"effects": {"leakage_internal": {"coefficient": -1}}}, "must be a number within [0, 1e-10] m3/s/Pa, not -1"),
    ({"effects": {"load_cell_gain": [{"ratio": 1.1}, {"ratio": 1.2}]}}, "names the same cell twice"),
    ({"effects": {"friction_presliding": {}, "friction_coulomb": {"form": "static"}}}, "give friction_coulomb form"),
    ({"bench": {"moving_mass": 0.5}, "effects": {"moving_mass": {"mass": -0.5}}}, "takes away all"),
    ({"effects": {"friction_viscous": {"coefficient": -61}}}, "takes away more than all"),
)


@pytest.mark.parametrize(("data", "sentence"), REFUSED)
def test_bad_truth_is_refused_in_one_sentence(data: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError) as caught:
        truth_from_mapping(data)
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


SEGMENTS = [
    Segment(seconds=0.6, amplitude=250.0, frequency=2.0),
    Segment(seconds=0.4, waveform="hold", offset=-80.0, kp=60.0, ki=5.0),
]


def columns(states: StateArray) -> dict[str, bytes]:
    """Every bit that means something; records have padding between their fields."""
    return {name: states[name].tobytes() for name in states.dtype.names or ()}


def test_offline_is_bitwise_what_the_real_time_loop_steps() -> None:
    effects = {"transport_delay": {"time": 1.3e-3}, "entrained_air": {"volume_fraction": 0.005}}
    everything = truth_from_mapping({"effects": effects, "outside": {"load_walk": {"force": 10.0}}})
    box = BoxConfig()
    offline = record_offline(everything, SEGMENTS, box=box, seed=7)
    machine = Machine(everything, box=box, seed=7)
    machine.warm_up()
    stepped, physical = np.empty(1000, STATE_DTYPE), np.empty((1000, len(TRUTH_FIELDS)))
    for k in range(1000):
        segment = SEGMENTS[0] if k < 600 else SEGMENTS[1]
        changes = {"delta_kp": segment.kp - box.base_kp, "delta_ki": segment.ki - box.base_ki}
        armed = Command(arm=True, reference=segment.signal, filter_fresh=True, **changes)
        machine.receive(armed if k else Command())
        stepped[k], physical[k] = machine.tick(), machine.physical
    assert columns(offline.states) == columns(stepped)
    assert offline.physical.tobytes() == physical.tobytes()
    assert np.ptp(stepped["load_force"]) > 100.0


def test_command_writes_a_bag_and_keeps_the_truth_out_of_it(tmp_path: Path) -> None:
    truth, bag = tmp_path / "truth.yaml", tmp_path / "bag"
    truth.write_text("profile: nominal\neffects: {leakage_internal: {coefficient: 1e-12}}\n")
    assert status_of(main, "--offline", "--truth", truth, "--seconds", 1, "--out", bag) == 0
    assert np.array_equal(read_bag(bag).state["sequence"], np.arange(1000))
    assert not any(b"leakage" in file.read_bytes() for file in bag.iterdir())


@pytest.mark.parametrize("name", FAULT_NAMES)
def test_each_fault_comes_as_often_as_it_says_and_changes_what_passes(name: str) -> None:
    frames = [bytes([0, *([1 + k % 200] * 20), 0]) for k in range(2000)]
    line = FaultyLine(LinkFaults(**{name: 0.2}), np.random.default_rng(0))
    changed = sum(line.transmit(frame, 0.0) != frame for frame in frames)
    assert line.counts[name] == pytest.approx(370, abs=80) and changed >= 0.9 * line.counts[name]


@pytest.fixture
def machine() -> Machine:
    return Machine(profile("default"))


@pytest.fixture
def link(tmp_path: Path, machine: Machine) -> Iterator[BoxLink]:
    made = BoxLink(Terminal(tmp_path / "port"), machine.box, LinkFaults())
    yield made
    made.terminal.unplug()


def send(link: BoxLink, machine: Machine, samples: int = 1) -> None:
    for _ in range(samples):
        machine.tick()
        link.send(machine.time)


def opened(link: BoxLink) -> closing[Port]:
    port = Port(PortSettings(path=str(link.terminal.path)))
    port.open()
    return closing(port)


def test_nobody_listening_costs_nothing_and_leaves_nothing_stale(link: BoxLink, machine: Machine) -> None:
    send(link, machine, 200)
    assert (link.unheard, link.sent) == (200, 0)
    with opened(link) as port:
        send(link, machine)
        hello, details, law, state = Decoder().feed(port.read(1.0))
    assert isinstance(hello, Hello) and hello.info is not None and hello.info.delta_u_max == pytest.approx(0.1)
    assert isinstance(details, Details) and isinstance(law, LawFrame)
    assert isinstance(state, State) and state.sequence >= 200


def test_unplugging_hangs_up_and_replugging_comes_back_behind_the_same_name(link: BoxLink, machine: Machine) -> None:
    with opened(link) as port:
        link.unplug(2.0, now=10.0)
        assert not link.terminal.path.exists()
        with pytest.raises(PortLostError):
            port.read(0.5)
    link.poll(11.9)
    assert not link.terminal.plugged
    link.poll(12.0)
    with opened(link) as again:
        send(link, machine)
        assert again.read(1.0)


def test_a_place_taken_by_a_file_is_refused_and_the_file_kept(tmp_path: Path) -> None:
    (tmp_path / "port").write_text("precious")
    with pytest.raises(SettingsError, match="exists and is not a link"):
        Terminal(tmp_path / "port")
    assert (tmp_path / "port").read_text() == "precious"


def test_orders_are_obeyed_or_refused_in_one_sentence(link: BoxLink, machine: Machine) -> None:
    execute_command("corrupt 0.25", machine, link, 0.0)
    execute_command("duplicate 0.5", machine, link, 0.0)
    assert link.up.faults == link.down.faults == LinkFaults(corrupt=0.25, duplicate=0.5)
    execute_command("clear", machine, link, 0.0)
    assert link.up.faults == LinkFaults()
    machine.tick()
    execute_command("reboot", machine, link, 0.0)
    assert machine.time == 0.0 and int(machine.tick()["sequence"]) == 0
    for order in ("", "melt", "corrupt", "corrupt 2", "corrupt x", "clear 1", "unplug -1"):
        with pytest.raises(SettingsError, match="order"):
            execute_command(order, machine, link, 0.0)
