# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydro_diagnosis.io.table import InputError
from hydro_diagnosis.preprocessing.loading import ENOUGH, load_dataset
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()


def tripped(recording: Path, folder: Path, moving: float) -> Path:
    """The recording, as it would be had the box tripped after `moving` s: the piston stands from then on."""
    data = pd.read_csv(recording)
    stands = data["time"] > data["time"].iloc[0] + moving
    data.loc[stands, "piston_position"] = data.loc[~stands, "piston_position"].iloc[-1]
    data.loc[stands, "valve_current"] = 0.0
    rest = BENCH.spring_stiffness * (data["piston_position"].iloc[-1] - BENCH.spring_rest_position)
    noise = np.random.default_rng(7).normal(0.0, 0.6, stands.sum())
    data.loc[stands, "load_force"] = rest + noise
    data.loc[stands, "piston_velocity"] = 0.0
    path = folder / f"tripped_{recording.stem}.csv"
    data.to_csv(path, index=False)
    return path


def test_too_little_motion_is_refused_and_the_remedy_is_named(worn: list[Path], tmp_path: Path) -> None:
    short = [tripped(recording, tmp_path, 1.2) for recording in worn[:2]]
    with pytest.raises(InputError, match=r"piston moves for 2\.\d s.*lower gains.*give the box.*valve_nominal_flow"):
        load_dataset(short, [worn[2]], BENCH)


def test_just_enough_motion_is_taken(worn: list[Path], tmp_path: Path) -> None:
    fitted, _, _ = load_dataset([tripped(recording, tmp_path, ENOUGH) for recording in worn[:2]], [worn[2]], BENCH)
    assert len(fitted) == 2


def test_held_out_recording_that_shows_nothing_is_replaced_and_listed(worn: list[Path], tmp_path: Path) -> None:
    still = tripped(worn[2], tmp_path, 0.0)
    fitted, held, notes = load_dataset(worn[:2], [still], BENCH)
    assert {one.recording for one in fitted} == {"run0"}
    assert {one.recording for one in held} == {"run1"}
    assert any(still.stem in note and "left out" in note for note in notes)
    assert any("run1 was held back" in note for note in notes)


def test_held_out_recording_that_is_fitted_too_is_refused(worn: list[Path]) -> None:
    with pytest.raises(InputError, match="run0 was given twice: what is checked on must not be fitted"):
        load_dataset(worn[:2], [worn[0]], BENCH)


def test_copies_under_another_name_or_in_another_format_are_refused(worn: list[Path], tmp_path: Path) -> None:
    copy = tmp_path / "wednesday.parquet"
    pd.read_csv(worn[1]).to_parquet(copy)
    with pytest.raises(InputError, match="run1 and wednesday hold the same"):
        load_dataset(worn[:2], [copy], BENCH)
    with pytest.raises(InputError, match="run1 and wednesday hold the same"):
        load_dataset([worn[1], copy], [], BENCH)
