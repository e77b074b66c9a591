# SPDX-License-Identifier: Apache-2.0
"""report.json is a contract: its keys and their types, for every verdict, by the schema that the package ships."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fastjsonschema
import numpy as np
import pandas as pd
import pytest

import hydro_diagnosis
from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE, StateArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.stages.reading import recording_entry
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import grown

SCHEMA = Path(hydro_diagnosis.__file__).parent / "data" / "report.schema.json"


@pytest.fixture(scope="module")
def valid() -> Callable[[Any], Any]:
    """Raises JsonSchemaValueException on what the contract does not allow."""
    compiled: Callable[[Any], Any] = fastjsonschema.compile(json.loads(SCHEMA.read_text()))
    return compiled


def test_explained(valid: Callable[[Any], Any], written: Path) -> None:
    report = json.loads((written / "report.json").read_text())
    valid(report)
    assert report["checked"] == ["pressure_a", "pressure_b", "actuation", "motion", "load", "sensor"]
    assert report["effects"] and report["location"] and report["fit"]["holdout"] and report["steps"]


def test_no_mismatch(valid: Callable[[Any], Any], csv: Path) -> None:
    report = json.loads(diagnose([csv]).report.to_json())
    valid(report)
    assert report["verdict"] == "no_mismatch"
    assert report["recordings"] == [{"name": csv.stem, "begin": None}]


def test_a_bag_is_known_by_the_stamp_of_its_first_sample(tmp_path: Path) -> None:
    states = np.zeros(50, STATE_DTYPE)
    states["time"], states["sequence"] = 1.7e9 + 0.25 + 1e-3 * np.arange(50), np.arange(50)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_states(states)
    assert recording_entry(tmp_path / "bag") == {"name": "bag", "begin": pytest.approx(1.7e9 + 0.25, abs=1e-6)}


def test_something_left_that_nobody_knows(
    valid: Callable[[Any], Any],
    record: Callable[..., StateArray],
    frame: Callable[[StateArray], pd.DataFrame],
    tmp_path: Path,
) -> None:
    """A cell that is struck twice a second, and no current, no pressures: nothing can be simulated forward."""
    states = record(Bench.nominal(), 7)
    table = frame(states)[["time", "hydraulic_force", "load_force", "piston_position"]]
    table.loc[(states["time"] % 0.5) < 0.02, "load_force"] += 40.0
    table.to_csv(tmp_path / "struck.csv", index=False)
    report = json.loads(diagnose([tmp_path / "struck.csv"]).report.to_json())
    valid(report)
    assert report["verdict"] == "unknown"
    assert report["remainder"]["location"] and report["fit"]["why"]


@pytest.mark.parametrize("key", ["verdict", "location", "effects", "fit", "next_recording", "checked", "not_checked",
                                 "data_quality", "baseline", "versions", "recordings", "seconds"])  # fmt: skip
def test_a_missing_key_breaks_the_contract(valid: Callable[[Any], Any], written: Path, key: str) -> None:
    report = json.loads((written / "report.json").read_text())
    del report[key]
    with pytest.raises(fastjsonschema.JsonSchemaValueException, match=key):
        valid(report)


def test_ids_of_the_contract_are_those_of_the_library() -> None:
    table = json.loads(SCHEMA.read_text())["definitions"]["cause"]["anyOf"][0]["enum"]
    assert set(table) == {effect.id for effect in LIBRARY} - grown.IDS
