# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.cli import run
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.segments import segment


def record(
    truth: Bench,
    seed: int = 1,
    seconds: float = 10.0,
    waveform: Waveform = Waveform.MULTISINE,
    amplitude: float = 260.0,
) -> StateArray:
    """A run of the analytic plant, which shares no code with the diagnosis; the box believes the nominal bench."""
    reference = ReferenceSignal(waveform=waveform, amplitude=amplitude, frequency=0.7)
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=seconds)
    return simulate(AnalyticPlant(truth), Bench.nominal(), schedule, seed=seed)


def frame(states: StateArray) -> pd.DataFrame:
    return pd.DataFrame({"time": states["time"], **{field: states[field] for field in STATE_FIELDS}})


@pytest.fixture(scope="session")
def nominal() -> StateArray:
    return record(Bench.nominal(), seconds=12.0)


@pytest.fixture(scope="session")
def problem(nominal: StateArray) -> Problem:
    return Problem([segment(nominal)], Bench.nominal())


@pytest.fixture(scope="session")
def problem_of() -> Callable[..., Problem]:
    def build(**values: Any) -> Problem:
        truth = replace(Bench.nominal(), **values)
        runs = [record(truth, 3), record(truth, 4, waveform=Waveform.SINE)]
        return Problem([segment(run) for run in runs], Bench.nominal())

    return build


@pytest.fixture(scope="session")
def csv(tmp_path_factory: pytest.TempPathFactory, nominal: StateArray) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "nominal.csv"
    frame(nominal).to_csv(path, index=False)
    return path


@pytest.fixture(scope="session")
def worn(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two recordings of a bench with a soft spring, and one to hold out."""
    folder = tmp_path_factory.mktemp("worn")
    truth = replace(Bench.nominal(), spring_stiffness=18500.0)
    paths = []
    for k, waveform in enumerate((Waveform.MULTISINE, Waveform.SINE, Waveform.SMOOTH_STEP)):
        paths.append(folder / f"run{k}.csv")
        frame(record(truth, 20 + k, waveform=waveform)).to_csv(paths[-1], index=False)
    return paths


@pytest.fixture(scope="session")
def written(worn: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes about the soft spring."""
    folder = tmp_path_factory.mktemp("written")
    assert run([str(worn[0]), str(worn[1]), "--holdout", str(worn[2]), "--out", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture(scope="session", name="record")
def record_fixture() -> Callable[..., StateArray]:
    return record


@pytest.fixture(scope="session", name="frame")
def frame_fixture() -> Callable[[StateArray], pd.DataFrame]:
    return frame
