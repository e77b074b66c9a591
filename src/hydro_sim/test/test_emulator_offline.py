# SPDX-License-Identifier: Apache-2.0
"""Offline recordings: the same samples as in real time to the bit, reproducible, and readable as bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.signals import STATE_DTYPE, Command, Flag, StateArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.command import main
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS
from hydro_sim.excitation.schedules import Segment

SEGMENTS = [
    Segment(seconds=0.6, amplitude=250.0, frequency=2.0),
    Segment(seconds=0.4, waveform="hold", offset=-80.0, kp=60.0, ki=5.0),
]
EVERYTHING = truth_from_mapping(
    {
        "effects": {"transport_delay": {"time": 1.3e-3}, "entrained_air": {"volume_fraction": 0.005}},
        "outside": {"load_walk": {"force": 10.0}},
    }
)


def columns(states: StateArray) -> dict[str, bytes]:
    """Every bit that means something; records have padding between their fields."""
    return {name: states[name].tobytes() for name in states.dtype.names or ()}


def rmse(kp: float, frequency: float, seconds: float = 6.0) -> float:
    """Tracking error [N] of fixed gains on the default truth; infinite if the box tripped."""
    states = record_offline(profile("default"), [Segment(seconds=seconds, amplitude=300.0, frequency=frequency, kp=kp)])
    settled = states.states[2000:]
    if np.any(settled["flags"] & Flag.TRIPPED):
        return np.inf
    return float(np.sqrt(np.mean((settled["reference_force"] - settled["load_force"]) ** 2)))


def test_offline_is_bitwise_what_the_real_time_loop_steps() -> None:
    box = BoxConfig()
    offline = record_offline(EVERYTHING, SEGMENTS, box=box, seed=7)
    machine = Machine(EVERYTHING, box=box, seed=7)
    machine.warm_up()
    stepped = np.empty(1000, STATE_DTYPE)
    physical = np.empty((1000, len(TRUTH_FIELDS)))
    for k in range(1000):
        segment = SEGMENTS[0] if k < 600 else SEGMENTS[1]
        changes = {"delta_kp": segment.kp - box.base_kp, "delta_ki": segment.ki - box.base_ki}
        armed = Command(arm=True, reference=segment.signal, filter_fresh=True, **changes)
        machine.receive(armed if k else Command())
        stepped[k] = machine.tick()
        physical[k] = machine.physical
    assert columns(offline.states) == columns(stepped)
    assert offline.physical.tobytes() == physical.tobytes()
    assert np.ptp(stepped["load_force"]) > 100.0


def test_a_seed_gives_one_recording_and_another_seed_another_noise() -> None:
    first, again, other = (record_offline(profile("default"), SEGMENTS, seed=seed) for seed in (1, 1, 2))
    assert columns(first.states) == columns(again.states)
    difference = first.states["pressure_a"] - other.states["pressure_a"]
    assert difference[:50].std() == pytest.approx(np.sqrt(2) * 6e3, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [0.5, 1.0, 1.5, 2.0])
def test_fixed_gains_turn_unstable_between_120_and_150_on_the_default_truth(frequency: float) -> None:
    """First a limit cycle of tens of newtons, then the box's force limit."""
    assert rmse(140.0, frequency) > 3.0 * rmse(120.0, frequency)
    assert rmse(150.0, frequency) == np.inf


def test_command_writes_a_bag_and_keeps_the_truth_out_of_it(tmp_path: Path) -> None:
    truth = tmp_path / "truth.yaml"
    truth.write_text("profile: nominal\neffects: {leakage_internal: {coefficient: 1e-12}}\n")
    bag, log = tmp_path / "bag", tmp_path / "free.npz"
    words = ["--offline", "--truth", str(truth), "--seconds", "1", "--out", str(bag), "--noise-free", str(log)]
    assert main(words) == 0
    states = read_bag(bag).state
    assert np.array_equal(states["sequence"], np.arange(1000))
    with np.load(log) as free:
        assert free["noise_free"].dtype == STATE_DTYPE
        assert np.array_equal(free["noise_free"]["valve_current"], states["valve_current"])
        assert free["physical"].shape == (1000, len(TRUTH_FIELDS))
        assert tuple(free["physical_fields"]) == TRUTH_FIELDS
    for file in bag.iterdir():
        assert b"leakage" not in file.read_bytes()
