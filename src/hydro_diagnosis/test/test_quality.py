# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydro_bridge.signals import ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.io.table import InputError, read_table
from hydro_diagnosis.preprocessing.quality import checked, frozen_encoder, repeats
from hydro_diagnosis.recording import Recording
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
Frame = Callable[[StateArray], pd.DataFrame]


def read(data: pd.DataFrame, folder: Path) -> Recording:
    path = folder / "run.csv"
    data.to_csv(path, index=False)
    return checked(read_table(path), BENCH)


def test_short_gap_is_bridged_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).drop(index=[3000, 3001]), tmp_path)
    assert len(recording.segments) == 1
    assert any("2 missing samples were bridged" in note for note in recording.quality)


def test_long_gap_cuts_the_recording(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).drop(index=range(5000, 5200)), tmp_path)
    assert len(recording.segments) == 2


def test_nan_run_is_cut_out_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    data = frame(nominal)
    data.loc[4000:4400, "pressure_a"] = np.nan
    recording = read(data, tmp_path)
    assert len(recording.segments) == 2
    assert any("no number of pressure_a in 401 samples from 4." in note for note in recording.quality)


def test_frozen_sensor_is_left_out_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).assign(pressure_b=5e6), tmp_path)
    assert "pressure_b" not in recording.channels
    assert any("pressure_b is frozen throughout" in note for note in recording.quality)


UNUSABLE: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "does not run forward": lambda data: data.assign(time=data["time"].to_numpy()[::-1]),
    "does not change": lambda data: data.assign(piston_position=0.04),
    "saturated": lambda data: data.assign(valve_current=0.05),
    "BenchState": lambda data: data[["time"]].assign(foo=0.0),
    "empty": lambda data: data.iloc[:0, :0],
}


def test_what_cannot_be_used_is_refused_with_its_reason(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    for said, change in UNUSABLE.items():
        with pytest.raises(InputError, match=said):
            read(change(frame(nominal)), tmp_path)


def frozen(data: pd.DataFrame, begin: int, end: int) -> pd.DataFrame:
    data = data.copy()
    data.loc[begin:end, "piston_position"] = data.loc[begin, "piston_position"]
    return data


@pytest.mark.parametrize("without", [[], ["load_force"], ["piston_velocity"], ["load_force", "piston_velocity"]])
def test_frozen_encoder_is_cut_out_and_listed(
    tmp_path: Path, nominal: StateArray, frame: Frame, without: list[str]
) -> None:
    """Whatever else tells it: the load's force, the velocity, or where the position comes back."""
    recording = read(frozen(frame(nominal), 5000, 8000).drop(columns=without), tmp_path)
    assert len(recording.segments) == 2
    assert any("piston_position is frozen in 3001 samples" in note for note in recording.quality)


@pytest.mark.parametrize("quantum", [1e-6, 5e-6, 5e-5])
@pytest.mark.parametrize(
    "waveform, amplitude", [(Waveform.HOLD, 0.0), (Waveform.SINE, 30.0), (Waveform.SMOOTH_STEP, 250.0)]
)
def test_piston_that_stands_is_no_frozen_encoder(waveform: Waveform, amplitude: float, quantum: float) -> None:
    """Dry friction holds it at every reversal; at rest a coarse encoder repeats itself for seconds."""
    states = stuck(waveform, amplitude)
    columns = {name: states[name].copy() for name in ("piston_position", "piston_velocity", "load_force")}
    columns["piston_position"] = quantum * np.round(columns["piston_position"] / quantum)
    if waveform != Waveform.SINE:
        assert repeats(columns["piston_position"]).sum() > 500  # else this shows nothing
    assert not frozen_encoder(columns, 1e-3, BENCH).any()


@cache
def stuck(waveform: Waveform, amplitude: float) -> StateArray:
    dry = Claim(next(one for one in LIBRARY if one.label == "friction_coulomb"), {"force": 25.0})
    reference = ReferenceSignal(waveform=waveform, amplitude=amplitude, offset=20.0, frequency=0.5)
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=6.0)
    return simulate(AnalyticPlant(corrected_bench(BENCH, [dry])), BENCH, schedule, seed=5)
