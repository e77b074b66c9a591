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
def valid() -> Callable[[Any], Any]:
    """Raises JsonSchemaValueException on what the contract does not allow."""
    schema = Path(hydro_diagnosis.__file__).parent / "data" / "report.schema.json"
    compiled: Callable[[Any], Any] = fastjsonschema.compile(json.loads(schema.read_text()))
    return compiled
