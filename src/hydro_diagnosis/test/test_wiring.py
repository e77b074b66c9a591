# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring are hypotheses: they are undone where that explains more, and no cause is taken for one."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from hydro_core.signals import STATE_FIELDS, StateArray, Waveform
from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.stages.hypotheses import read_repaired, suspected_repairs
from hydro_diagnosis.stages.reading import Case, Question
from hydro_diagnosis.wiring import inspect_table, reversed_sign
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.segments import record

BENCH = Bench.nominal()
Channels = dict[str, npt.NDArray[np.float64]]


def scaled(*fields: str, by: float, plus: float = 0.0) -> Callable[[Channels], Channels]:
    return lambda c: {**c, **{field: by * c[field] + plus for field in fields}}


def moved(field: str, rows: int) -> Callable[[Channels], Channels]:
    return lambda c: {**c, field: np.roll(c[field], rows)}


def exchanged(one: str, other: str) -> Callable[[Channels], Channels]:
    return lambda c: {**c, one: c[other], other: c[one]}


MISTAKES: dict[str, tuple[Callable[[Channels], Channels], str]] = {
    "valve_current has the wrong sign": (scaled("valve_current", by=-1.0), "valve_current=valve_current*-1"),
    "pressure_a is in bar, and pressure_b is in bar": (
        scaled("pressure_a", "pressure_b", by=1e-5),
        "pressure_a=pressure_a[bar],pressure_b=pressure_b[bar]",
    ),
    "pressure_a and pressure_b are exchanged": (
        exchanged("pressure_a", "pressure_b"),
        "pressure_a=pressure_b,pressure_b=pressure_a",
    ),
    "piston_position has its zero elsewhere": (
        scaled("piston_position", by=1.0, plus=-0.04),
        "piston_position=piston_position+0.0",
    ),
    "piston_position is the velocity": (
        lambda c: {**c, "piston_position": c["piston_velocity"]},
        "piston_velocity=piston_position,piston_position=none",
    ),
    "load_force holds the column of hydraulic_force": (
        lambda c: {**c, "load_force": c["hydraulic_force"]},
        "load_force=none",
    ),
    "pressure_a was recorded about 40 ms late": (moved("pressure_a", 40), "pressure_a=pressure_a@40ms"),
    "piston_position is in mm, and valve_current has the wrong sign": (
        lambda c: {**c, "valve_current": -c["valve_current"], "piston_position": 1e3 * c["piston_position"]},
        "piston_position=piston_position[mm],valve_current=valve_current*-1",
    ),
}
"""By what must be said: what was done to the recordings, and what the map must hold that repairs them."""


def fields(states: StateArray) -> Channels:
    return {name: states[name].astype(np.float64) for name in STATE_FIELDS}


def written(channels: Channels, path: Path) -> Path:
    time = 1e-3 * np.arange(len(channels["piston_position"]))
    pd.DataFrame({"time": time, **channels}).to_csv(path, index=False)
    return path


def read(recordings: list[Path], **options: Any) -> Case:
    given = {"bench": None, "model": None, "columns": None, "without": (), "estimate": (), "as_wired": False}
    question = Question(recordings=recordings[:1], holdout=recordings[1:], **{**given, **options})
    return read_repaired(question, lambda text: None)


@pytest.fixture(scope="module")
def runs() -> list[Channels]:
    """Of a bench with much that is wrong with it."""
    worn = replace(BENCH, spring_stiffness=18500.0, viscous_friction=110.0, bulk_modulus=1.0e9)
    return [fields(record(worn, 31, 6.0)), fields(record(worn, 32, 6.0, waveform=Waveform.SMOOTH_STEP))]


@pytest.mark.parametrize(
    "every", [slice(0, None, 6), pytest.param(slice(None), marks=pytest.mark.study)], ids=["some", "all"]
)
def test_every_mistake_is_undone_and_told_with_its_repair(every: slice, runs: list[Channels], tmp_path: Path) -> None:
    for said, (make, repair) in list(MISTAKES.items())[every]:
        case = read([written(make(one), tmp_path / f"run{k}.csv") for k, one in enumerate(runs)])
        assert said in case.wiring, case.wiring
        assert repair in case.wiring.split('--columns "')[1].split('"')[0], case.wiring
        assert "diagnosed as repaired" in case.wiring and "\n" not in case.wiring


SUSPECTED: dict[str, Callable[[Channels], Channels]] = {
    "load_force has the wrong sign": scaled("load_force", by=-1.0),
    "hydraulic_force has the wrong sign": scaled("hydraulic_force", by=-1.0),
    "piston_position has the wrong sign": scaled("piston_position", by=-1.0, plus=BENCH.stroke),
    "hydraulic_force and load_force are exchanged": exchanged("hydraulic_force", "load_force"),
}
"""Mistakes that one look suspects, before any cause is sought."""


def test_signs_and_exchanges_are_suspected_before_a_cause_is_sought(runs: list[Channels]) -> None:
    time = 1e-3 * np.arange(len(runs[0]["load_force"]))
    for said, change in SUSPECTED.items():
        segments = check_recording(RawTable("run", time, None, {**change(runs[0])}), BENCH).segments
        assert [repair.sentence for repair in suspected_repairs(Problem(segments, BENCH), ())] == [said]
    assert str(reversed_sign("load_force").edit(cast(ColumnMap, ColumnMap.load("load_force=x*-1")))) == "load_force=x"


@pytest.mark.study
def test_zero_within_the_stroke_is_told_from_a_spring_that_rests_elsewhere(tmp_path: Path) -> None:
    """Where the volumes tell the position: those of the hoses must not be much larger than the piston's."""
    short = replace(BENCH, dead_volume_a=2e-5, dead_volume_b=2e-5)
    another_spring = replace(short, spring_rest_position=0.05, dead_volume_a=3e-5)
    for truth, moved in ((short, 0.012), (another_spring, 0.0)):
        change = scaled("piston_position", by=1.0, plus=moved)
        paths = []
        for k, waveform in enumerate((Waveform.MULTISINE, Waveform.SINE)):
            states = record(truth, k, 6.0, waveform, believed=short)
            paths.append(written(change(fields(states)), tmp_path / f"run{k}.csv"))
        found = diagnose(paths[:1], holdout=paths[1:], bench=short)
        said = " ".join(found.report.data_quality)
        assert ("piston_position=piston_position-0.012" in said) == (moved > 0.0), said
        assert {one.id for one in found.report.effects} == (set() if moved else {"spring_rest", "dead_volume"})


def test_a_unit_that_a_map_states_wrongly_is_replaced(runs: list[Channels], tmp_path: Path) -> None:
    change = scaled("pressure_a", by=1e-5)
    recordings = [written(change(one), tmp_path / f"run{k}.csv") for k, one in enumerate(runs)]
    case = read(recordings, columns="pressure_a=pressure_a[kPa]")
    assert "pressure_a is in bar, not kPa" in case.wiring and "pressure_a=pressure_a[bar]" in case.wiring


RIGHT: tuple[tuple[dict[str, Any], float], ...] = (
    ({"leakage_internal": {"coefficient": 1.4e-13}}, 80.0),
    ({"leakage_internal": {"coefficient": 3.3e-13}}, 60.0),
    ({"leakage_internal": {"coefficient": 2.5e-13}, "friction_viscous": {"coefficient": 60.0}}, 80.0),
    ({"leakage_internal": {"coefficient": 3.3e-13}, "valve_gain_asymmetry": {"ratio": 0.95}}, 60.0),
)
"""Effects and K_p of benches whose current leads the piston by 11 to 20 ms under a slow sine: the loop makes that."""


@pytest.mark.parametrize("cases", [RIGHT[-1:], pytest.param(RIGHT[:-1], marks=pytest.mark.study)], ids=["one", "all"])
@pytest.mark.study
def test_benches_that_leak_are_wired_right(cases: Sequence[tuple[dict[str, Any], float]], tmp_path: Path) -> None:
    for number, (effects, kp) in enumerate(cases):
        truth = truth_from_mapping({"profile": "nominal", "effects": effects})
        paths = []
        for k, (seconds, waveform, rate) in enumerate(((8.0, "multisine", 0.7), (40.0, "sine", 0.5))):
            segment = Segment(seconds=seconds, waveform=waveform, amplitude=300.0, frequency=rate, kp=kp, ki=10.0)
            states = record_offline(truth, [segment], seed=10 * number + k).states
            paths.append(tmp_path / f"{number}.{k}.csv")
            written(fields(states), paths[-1])
        out = tmp_path / str(number)
        assert run([str(paths[0]), "--holdout", str(paths[1]), "--out", str(out), "--quiet"]) == 0
        report = json.loads((out / "report.json").read_text())
        assert report["verdict"] == "explained"
        assert {effect["id"] for effect in report["effects"]} == set(effects)
        assert not any("diagnosed as repaired" in note for note in report["data_quality"])


def test_current_a_row_late_is_repaired_and_a_row_early_is_a_dead_time(nominal: StateArray, tmp_path: Path) -> None:
    """Of what causes leave: the mismatch of a single row is too small to be suspected before."""
    for rows, verdict, names in ((1, "no_mismatch", []), (-1, "explained", ["transport_delay"])):
        path = written(moved("valve_current", rows)(fields(nominal)), tmp_path / "run.csv")
        found = diagnose([path])
        assert found.report.verdict == verdict
        assert [effect.id for effect in found.report.effects] == names
        late = "valve_current was recorded about 1 ms late: the recordings were diagnosed as repaired"
        assert any(late in note for note in found.report.data_quality) == (rows > 0)


def test_both_explanations_are_told_where_both_fit(runs: list[Channels], tmp_path: Path) -> None:
    """A current that is 25 ms early is a dead time of 25 ms: it stays one."""
    paths = [written(moved("valve_current", -25)(one), tmp_path / f"run{k}.csv") for k, one in enumerate(runs)]
    case = read(paths)
    assert case.question.columns is None
    assert "early, but were diagnosed as recorded (in a trial of both, " in case.wiring
    assert 'diagnose with --columns "valve_current=valve_current@-2' in case.wiring


def test_as_wired_tries_no_repair_and_a_map_that_repairs_is_enough(runs: list[Channels], tmp_path: Path) -> None:
    paths = [written(scaled("load_force", by=-1.0)(one), tmp_path / f"run{k}.csv") for k, one in enumerate(runs)]
    as_wired = read(paths, as_wired=True)
    assert as_wired.wiring == "" and as_wired.question.columns is None
    mapped = read(paths, columns=ColumnMap.load("load_force=load_force*-1"))
    assert mapped.wiring == ""
    metres = [written(scaled("piston_position", by=1e3)(one), tmp_path / f"mm{k}.csv") for k, one in enumerate(runs)]
    with pytest.raises(InputError, match="the stroke of the bench from 0 to 80 mm"):
        read(metres, as_wired=True)


def test_right_recordings_raise_no_suspicion(problem: Problem, nominal: StateArray) -> None:
    assert suspected_repairs(problem, ()) == ()
    assert inspect_table(RawTable("run", nominal["time"].copy(), None, fields(nominal)), BENCH).doubts == []
