# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring are hypotheses: they are undone where that explains more, and no cause is taken for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hydro_core.signals import STATE_FIELDS, FloatArray, StateArray, Waveform
from hydro_diagnosis import diagnose
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.stages.hypotheses import prepare_best_wiring, suspected_repairs
from hydro_diagnosis.stages.reading import DiagnosisInput, PreparedDiagnosis
from hydro_diagnosis.wiring import check_plausibility, reversed_sign
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.segments import record

BENCH = Bench.nominal()
Channels = dict[str, FloatArray]
Change = Callable[[Channels], Channels]


def scaled(*fields: str, by: float, plus: float = 0.0) -> Change:
    return lambda c: {**c, **{field: by * c[field] + plus for field in fields}}


def moved(field: str, rows: int) -> Change:
    return lambda c: {**c, field: np.roll(c[field], rows)}


def exchanged(one: str, other: str) -> Change:
    return lambda c: {**c, one: c[other], other: c[one]}


def replaced(field: str, other: str) -> Change:
    return lambda c: {**c, field: c[other]}


MISTAKES: dict[str, tuple[Change, str]] = {
    "valve_current has the wrong sign": (scaled("valve_current", by=-1.0), "valve_current=valve_current*-1"),
    "pressure_a is in bar, and pressure_b is in bar": (
        scaled("pressure_a", "pressure_b", by=1e-5), "pressure_a=pressure_a[bar],pressure_b=pressure_b[bar]"),
    "pressure_a and pressure_b are exchanged": (
        exchanged("pressure_a", "pressure_b"), "pressure_a=pressure_b,pressure_b=pressure_a"),
    "piston_position has its zero elsewhere": (
        scaled("piston_position", by=1.0, plus=-0.04), "piston_position=piston_position+0.0"),
    "piston_position is the velocity": (
        replaced("piston_position", "piston_velocity"), "piston_velocity=piston_position,piston_position=none"),
    "load_force holds the column of hydraulic_force": (replaced("load_force", "hydraulic_force"), "load_force=none"),
    "pressure_a was recorded about 40 ms late": (moved("pressure_a", 40), "pressure_a=pressure_a@40ms"),
    "piston_position is in mm, and valve_current has the wrong sign": (
        lambda c: {**c, "valve_current": -c["valve_current"], "piston_position": 1e3 * c["piston_position"]},
        "piston_position=piston_position[mm],valve_current=valve_current*-1"),
}  # fmt: skip
"""By what must be said: what was done to the recordings, and what the map must hold that repairs them."""


def fields(states: StateArray) -> Channels:
    return {name: states[name].astype(np.float64) for name in STATE_FIELDS}


def written(folder: Path, *runs: Channels, change: Change = lambda channels: channels) -> list[Path]:
    paths = []
    for k, channels in enumerate(runs):
        paths.append(folder / f"run{k}.csv")
        time = 1e-3 * np.arange(len(channels["piston_position"]))
        pd.DataFrame({"time": time, **change(channels)}).to_csv(paths[-1], index=False)
    return paths


def read(recordings: list[Path], **options: Any) -> PreparedDiagnosis:
    given = {"bench": None, "model": None, "columns": None, "without": (), "estimate": (), "as_wired": False}
    inputs = DiagnosisInput(recordings=recordings[:1], holdout=recordings[1:], **{**given, **options})
    return prepare_best_wiring(inputs, lambda text: None)


@pytest.fixture(scope="module")
def runs() -> list[Channels]:
    """Of a bench with much that is wrong with it."""
    worn = replace(BENCH, spring_stiffness=18500.0, viscous_friction=110.0, bulk_modulus=1.0e9)
    return [fields(record(worn, 31, 6.0)), fields(record(worn, 32, 6.0, waveform=Waveform.SMOOTH_STEP))]


@pytest.mark.parametrize(
    "said", [pytest.param(said, marks=[pytest.mark.study] if k % 6 else []) for k, said in enumerate(MISTAKES)]
)
def test_every_mistake_is_undone_and_told_with_its_repair(said: str, runs: list[Channels], tmp_path: Path) -> None:
    change, repair = MISTAKES[said]
    wiring = read(written(tmp_path, *runs, change=change)).wiring
    assert said in wiring and repair in wiring.split('--columns "')[1].split('"')[0], wiring
    assert "diagnosed as repaired" in wiring and "\n" not in wiring


SUSPECTED: dict[str, Change] = {
    "load_force has the wrong sign": scaled("load_force", by=-1.0),
    "hydraulic_force has the wrong sign": scaled("hydraulic_force", by=-1.0),
    "piston_position has the wrong sign": scaled("piston_position", by=-1.0, plus=BENCH.stroke),
    "hydraulic_force and load_force are exchanged": exchanged("hydraulic_force", "load_force"),
}
"""Mistakes that one look suspects, before any cause is sought."""


def test_signs_and_exchanges_are_suspected_before_a_cause_is_sought(runs: list[Channels]) -> None:
    time = 1e-3 * np.arange(len(runs[0]["load_force"]))
    for said, change in SUSPECTED.items():
        segments = check_recording(RawTable("run", time, None, change(runs[0])), BENCH).segments
        assert [repair.sentence for repair in suspected_repairs(Problem(segments, BENCH), ())] == [said]
    assert str(reversed_sign("load_force").edit(ColumnMap.load("load_force=x*-1"))) == "load_force=x"


@pytest.mark.study
def test_zero_within_the_stroke_is_told_from_a_spring_that_rests_elsewhere(tmp_path: Path) -> None:
    """Where the volumes tell the position: those of the hoses must not be much larger than the piston's."""
    short = replace(BENCH, dead_volume_a=2e-5, dead_volume_b=2e-5)
    another_spring = replace(short, spring_rest_position=0.05, dead_volume_a=3e-5)
    for truth, offset, causes in (short, 0.012, set()), (another_spring, 0.0, {"spring_rest", "dead_volume"}):
        states = [
            record(truth, k, 6.0, one, believed=short) for k, one in enumerate((Waveform.MULTISINE, Waveform.SINE))
        ]
        paths = written(tmp_path, *map(fields, states), change=scaled("piston_position", by=1.0, plus=offset))
        report = diagnose(paths[:1], holdout=paths[1:], bench=short).report
        said = " ".join(report.data_quality)
        assert ("piston_position=piston_position-0.012" in said) == (not causes), said
        assert {one.id for one in report.effects} == causes


def test_a_unit_that_a_map_states_wrongly_is_replaced(runs: list[Channels], tmp_path: Path) -> None:
    recordings = written(tmp_path, *runs, change=scaled("pressure_a", by=1e-5))
    prepared = read(recordings, columns="pressure_a=pressure_a[kPa]")
    assert "pressure_a is in bar, not kPa" in prepared.wiring and "pressure_a=pressure_a[bar]" in prepared.wiring


@pytest.mark.study
@pytest.mark.parametrize(
    ("effects", "kp"),
    [
        ({"leakage_internal": {"coefficient": 1.4e-13}}, 80.0),
        ({"leakage_internal": {"coefficient": 3.3e-13}}, 60.0),
        ({"leakage_internal": {"coefficient": 2.5e-13}, "friction_viscous": {"coefficient": 60.0}}, 80.0),
        ({"leakage_internal": {"coefficient": 3.3e-13}, "valve_gain_asymmetry": {"ratio": 0.95}}, 60.0),
    ],
)
def test_benches_that_leak_are_wired_right(effects: dict[str, Any], kp: float, tmp_path: Path) -> None:
    """Their current leads the piston by 11 to 20 ms under a slow sine: the loop makes that."""
    truth, drives = truth_from_mapping({"profile": "nominal", "effects": effects}), []
    for k, (seconds, waveform, rate) in enumerate(((8.0, "multisine", 0.7), (40.0, "sine", 0.5))):
        segment = Segment(seconds=seconds, waveform=waveform, amplitude=300.0, frequency=rate, kp=kp, ki=10.0)
        drives.append(fields(record_offline(truth, [segment], seed=k).states))
    fitted, held = written(tmp_path, *drives)
    report = diagnose([fitted], holdout=[held]).report
    assert report.verdict == "explained"
    assert {effect.id for effect in report.effects} == set(effects)
    assert not any("diagnosed as repaired" in note for note in report.data_quality)


def test_current_a_row_late_is_repaired_and_a_row_early_is_a_dead_time(nominal: StateArray, tmp_path: Path) -> None:
    """Of what causes leave: the mismatch of a single row is too small to be suspected before."""
    for rows, verdict, names in ((1, "no_mismatch", []), (-1, "explained", ["transport_delay"])):
        report = diagnose(written(tmp_path, fields(nominal), change=moved("valve_current", rows))).report
        assert report.verdict == verdict
        assert [effect.id for effect in report.effects] == names
        late = "valve_current was recorded about 1 ms late: the recordings were diagnosed as repaired"
        assert any(late in note for note in report.data_quality) == (rows > 0)


def test_both_explanations_are_told_where_both_fit(runs: list[Channels], tmp_path: Path) -> None:
    """A current that is 25 ms early is a dead time of 25 ms: it stays one."""
    prepared = read(written(tmp_path, *runs, change=moved("valve_current", -25)))
    assert prepared.inputs.columns is None
    assert "early, but were diagnosed as recorded; to have them repaired" in prepared.wiring
    assert 'diagnose with --columns "valve_current=valve_current@-2' in prepared.wiring


def test_as_wired_tries_no_repair_and_a_map_that_repairs_is_enough(runs: list[Channels], tmp_path: Path) -> None:
    paths = written(tmp_path, *runs, change=scaled("load_force", by=-1.0))
    as_wired = read(paths, as_wired=True)
    assert as_wired.wiring == "" and as_wired.inputs.columns is None
    assert read(paths, columns=ColumnMap.load("load_force=load_force*-1")).wiring == ""
    with pytest.raises(InputError, match="the stroke of the bench from 0 to 80 mm"):
        read(written(tmp_path, *runs, change=scaled("piston_position", by=1e3)), as_wired=True)


def test_right_recordings_raise_no_suspicion(problem: Problem, nominal: StateArray) -> None:
    assert suspected_repairs(problem, ()) == ()
    assert check_plausibility(RawTable("run", nominal["time"].copy(), None, fields(nominal)), BENCH).doubts == []
