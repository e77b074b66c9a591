# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fastjsonschema
import pytest

import hydro_diagnosis
from hydro_core.signals import StateArray, Waveform
from hydro_diagnosis.cli import run
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.bench import Bench
from tests.segments import frame, problem_in, record


@pytest.fixture(scope="session")
def nominal() -> StateArray:
    return record(Bench.nominal(), seconds=12.0)


@pytest.fixture(scope="session")
def problem(nominal: StateArray) -> Problem:
    return problem_in(nominal)


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


SCHEMA = Path(hydro_diagnosis.__file__).parent / "data" / "report.schema.json"


@pytest.fixture(scope="session")
def valid() -> Callable[[Any], Any]:
    """Raises JsonSchemaValueException on what the contract does not allow."""
    compiled: Callable[[Any], Any] = fastjsonschema.compile(json.loads(SCHEMA.read_text()))
    return compiled
