# SPDX-License-Identifier: Apache-2.0
"""Offline recordings: the same samples as in real time to the bit, reproducible, and readable as bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.signals import PLANT_FIELDS, STATE_DTYPE, Command, Flag, StateArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.command import main
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.schedules import DEFAULT_SCHEDULE
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


def test_recording_counts_samples_arms_and_follows_its_schedule() -> None:
    states = record_offline(profile("default"), SEGMENTS).states
    assert np.array_equal(states["sequence"], np.arange(1000))
    assert states["time"] == pytest.approx(np.arange(1000) * 1e-3, abs=1e-12)
    armed = (states["flags"] & Flag.ARMED) > 0
    assert not armed[0] and armed[1:].all()
    assert states["proportional_gain"][599] == pytest.approx(90.0)
    assert states["proportional_gain"][600] == pytest.approx(60.0)
    assert states["reference_force"][-1] == pytest.approx(-80.0)


def test_noise_free_log_is_the_same_run_without_noise() -> None:
    recording = record_offline(profile("default"), SEGMENTS)
    for name in PLANT_FIELDS[0::2][:2] + ("pressure_a", "piston_position"):
        noise = recording.states[name] - recording.noise_free[name]
        assert 0.0 < noise.std() < 0.01 * np.ptp(recording.noise_free[name])
    for name in ("valve_current", "reference_force", "time", "flags"):
        assert np.array_equal(recording.states[name], recording.noise_free[name])
    position = recording.physical[:, TRUTH_FIELDS.index("piston_position")]
    assert np.abs(recording.noise_free["piston_position"] - position).max() < 1e-15


def test_pressures_stay_between_3_and_14_mpa_in_a_normal_run() -> None:
    recording = record_offline(profile("default"), DEFAULT_SCHEDULE)
    for name in ("pressure_a", "pressure_b"):
        assert recording.noise_free[name].min() > 3e6
        assert recording.noise_free[name].max() < 14e6
    assert not np.any(recording.states["flags"] & Flag.TRIPPED)


@pytest.mark.slow
@pytest.mark.parametrize(("frequency", "limit"), [(0.5, 9.0), (1.0, 14.0), (1.5, 24.0), (2.0, 44.0)])
def test_fixed_gains_track_up_to_120_on_the_default_truth(frequency: float, limit: float) -> None:
    assert rmse(90.0, frequency) < limit
    assert rmse(120.0, frequency) < limit


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


def test_batch_records_many_jobs_with_one_command(tmp_path: Path) -> None:
    jobs = tmp_path / "jobs.yaml"
    entry = "- {{out: {0}/{1}, seconds: 0.1, seed: {2}}}\n"
    jobs.write_text("jobs:\n" + "".join(entry.format(tmp_path, name, seed) for seed, name in enumerate("ab")))
    assert main(["--batch", str(jobs)]) == 0
    first, second = (read_bag(tmp_path / name).state for name in "ab")
    assert len(first) == len(second) == 100
    assert not np.array_equal(first["load_force"], second["load_force"])


def test_the_form_of_the_integral_is_an_option_and_bumpless_the_default(tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.yaml"
    segment = "- {{seconds: 0.4, amplitude: 100, frequency: 2.0, kp: 60, ki: {0}}}\n"
    schedule.write_text("segments:\n" + segment.format(15) + segment.format(90))
    words = ["--offline", "--schedule", str(schedule), "--out"]
    for name, option in (("a", []), ("b", ["--integral", "bumpless"]), ("c", ["--integral", "paper"])):
        assert main([*words, str(tmp_path / name), *option]) == 0
    default, bumpless, paper = (read_bag(tmp_path / name).state["nominal_valve_current"] for name in "abc")
    np.testing.assert_array_equal(default, bumpless)
    np.testing.assert_allclose(paper[:400], bumpless[:400], atol=1e-12)
    assert np.abs(paper[400:] - bumpless[400:]).max() > 1e-5


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--offline"], "--offline needs --out"),
        (["--out", "bag"], "add --offline"),
        (["--offline", "--out", "bag", "--truth", "none.yaml"], "none.yaml cannot be read"),
        (["--offline", "--out", "bag", "--seconds", "-1"], "emulator.seconds must be within"),
        (["--batch", "none.yaml"], "none.yaml cannot be read"),
        (["--seconds", "nan"], "--seconds nan"),
        (["--seconds", "-3"], "--seconds -3"),
        (["--seed", "-1"], "--seed -1"),
    ],
)
def test_wrong_words_end_in_one_sentence_and_status_2(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("words", [["--out", "/dev/null/x"], ["--out", "bag", "--noise-free", "/dev/null/x"]])
def test_a_place_that_cannot_be_written_is_found_before_the_recording(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--offline", *words])
    assert ended.value.code == 2
    assert "/dev/null is no folder: choose another place" in capsys.readouterr().err.splitlines()[-1]


def test_what_the_system_refuses_in_a_batch_is_one_sentence_without_a_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = {"out": str(tmp_path / "bag"), "seconds": 0.1, "noise_free": "/dev/null/x.npz"}
    (tmp_path / "jobs.yaml").write_text(yaml.safe_dump({"jobs": [job]}), encoding="utf-8")
    assert main(["--batch", str(tmp_path / "jobs.yaml")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: /dev/null") and "Errno" not in error and error.count("\n") == 1
