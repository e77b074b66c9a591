# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import yaml

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.signals import STATE_FIELDS, StateArray, Waveform
from hydro_diagnosis.blind_benchmark.cases import Case
from hydro_diagnosis.blind_benchmark.magnitudes import FORMS, OUTSIDE, SINGLES, VALUES, Pick, Shape, Size
from hydro_diagnosis.blind_benchmark.recording import run_emulator, truth_of
from hydro_diagnosis.dataset.loading import load_dataset
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable, read_table
from hydro_diagnosis.wiring.wiring import WiringError, mistakes, wiring_checked
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
Channels = dict[str, npt.NDArray[np.float64]]
Record = Callable[..., StateArray]


def late(values: npt.NDArray[np.float64], samples: int) -> npt.NDArray[np.float64]:
    return np.concatenate([np.full(samples, values[0]), values[:-samples]])


def scaled(*fields: str, by: float) -> Callable[[Channels], Channels]:
    return lambda c: {**c, **{field: by * c[field] for field in fields}}


def delayed(field: str, samples: int) -> Callable[[Channels], Channels]:
    return lambda c: {**c, field: late(c[field], samples)}


MISTAKES: dict[str, tuple[Callable[[Channels], Channels], list[str], str]] = {
    "current, sign": (
        scaled("valve_current", by=-1.0),
        ["valve_current has the wrong sign"],
        "valve_current=valve_current*-1",
    ),
    "hydraulic force, sign": (
        scaled("hydraulic_force", by=-1.0),
        ["hydraulic_force has the wrong sign"],
        "hydraulic_force=hydraulic_force*-1",
    ),
    "load force, sign": (
        scaled("load_force", by=-1.0),
        ["load_force has the wrong sign"],
        "load_force=load_force*-1",
    ),
    "pressures exchanged": (
        lambda c: {**c, "pressure_a": c["pressure_b"], "pressure_b": c["pressure_a"]},
        ["pressure_a and pressure_b are exchanged"],
        "pressure_a=pressure_b,pressure_b=pressure_a",
    ),
    "position in mm": (
        scaled("piston_position", by=1e3),
        ["piston_position is in mm"],
        "piston_position=piston_position[mm]",
    ),
    "position in counts": (
        scaled("piston_position", by=1.0 / 5e-6),
        ["piston_position is in counts of about"],
        "piston_position=piston_position*",
    ),
    "position from mid-stroke": (
        lambda c: {**c, "piston_position": c["piston_position"] - 0.04},
        ["piston_position has its zero elsewhere"],
        "piston_position=piston_position+0.04",
    ),
    "pressures in bar": (
        scaled("pressure_a", "pressure_b", by=1e-5),
        ["pressure_a is in bar", "pressure_b is in bar"],
        "pressure_a=pressure_a[bar]",
    ),
    "pressures in kPa": (
        scaled("pressure_a", "pressure_b", by=1e-3),
        ["pressure_a is in kPa", "pressure_b is in kPa"],
        "pressure_b=pressure_b[kPa]",
    ),
    "current in mA": (
        scaled("valve_current", by=1e3),
        ["valve_current is in mA"],
        "valve_current=valve_current[mA]",
    ),
    "forces in kN": (
        scaled("hydraulic_force", "load_force", by=1e-3),
        ["hydraulic_force is in kN", "load_force is in kN"],
        "load_force=load_force[kN]",
    ),
    "velocity for position": (
        lambda c: {**c, "piston_position": c["piston_velocity"]},
        ["piston_position is the velocity"],
        "piston_velocity=piston_position,piston_position=none",
    ),
    "load force a copy": (
        lambda c: {**c, "load_force": c["hydraulic_force"].copy()},
        ["load_force holds the column of hydraulic_force"],
        "load_force=none",
    ),
    "pressure a copy": (
        lambda c: {**c, "pressure_a": c["pressure_b"].copy()},
        ["pressure_a holds the column of pressure_b"],
        "pressure_a=none",
    ),
    "pressure a 40 ms late": (delayed("pressure_a", 40), ["pressure_a was recorded about"], "pressure_a=pressure_a@"),
    "current 30 ms late": (
        delayed("valve_current", 30),
        ["valve_current was recorded about"],
        "valve_current=valve_current@",
    ),
    "current reversed, position in mm": (
        lambda c: {**c, "valve_current": -c["valve_current"], "piston_position": 1e3 * c["piston_position"]},
        ["piston_position is in mm", "valve_current has the wrong sign"],
        "valve_current=valve_current*-1",
    ),
}
"""What was done to a recording; what must be said; what the repair must hold."""


def fields(states: StateArray) -> Channels:
    return {name: states[name].astype(np.float64) for name in STATE_FIELDS}


def table(channels: Channels, step: float = 1e-3) -> RawTable:
    time = np.arange(len(next(iter(channels.values())))) * step
    return RawTable("run", time, None, channels)


@pytest.fixture(scope="module")
def runs(record: Record) -> list[StateArray]:
    """A clean bench, and one with much that is wrong with it, by another reference."""
    worn = replace(BENCH, spring_stiffness=17500.0, viscous_friction=110.0, bulk_modulus=1.0e9, supply_pressure=14.5e6)
    return [record(BENCH, 31), record(worn, 32, waveform=Waveform.SMOOTH_STEP)]


@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_mistake_is_told_with_its_repair(name: str, runs: list[StateArray]) -> None:
    make, said, repair = MISTAKES[name]
    for states in runs:
        with pytest.raises(WiringError) as raised:
            wiring_checked(table(make(fields(states))), BENCH, None)
        message = str(raised.value)
        assert all(one in message for one in said), message
        assert repair in message.split('--columns "')[1], message
        assert message.count("has the wrong sign") == sum("sign" in one for one in said)
        assert "\n" not in message


@pytest.mark.parametrize(
    "name", sorted(set(MISTAKES) - {"velocity for position", "load force a copy", "pressure a copy"})
)
def test_repaired_recording_is_the_right_one(name: str, runs: list[StateArray], tmp_path: Path) -> None:
    make, _, _ = MISTAKES[name]
    right = fields(runs[0])
    wrong = table(make(right))
    path = tmp_path / "run.csv"
    pd.DataFrame({"time": wrong.time, **wrong.columns}).to_csv(path, index=False)
    with pytest.raises(WiringError) as raised:
        wiring_checked(read_table(path), BENCH, None)
    columns = ColumnMap.load(str(raised.value).split('--columns "')[1].split('"')[0])
    repaired = read_table(path, columns)
    assert mistakes(repaired, BENCH) is None
    about = 0.02 if "late" in name or "counts" in name or "mid" in name else 1e-9
    inner = slice(100, -100)
    for field in ("valve_current", "pressure_a", "pressure_b", "piston_position", "hydraulic_force", "load_force"):
        span = float(np.ptp(right[field]))
        error = repaired.columns[field][: len(right[field])][inner] - right[field][: len(repaired.time)][inner]
        assert float(np.sqrt(np.mean(error**2))) < about * span, field


def test_contradiction_that_no_mistake_explains_is_a_note(runs: list[StateArray]) -> None:
    channels = fields(runs[0])
    channels["pressure_b"] = np.random.default_rng(3).normal(0.0, 6e3, len(channels["pressure_b"]))
    noted = wiring_checked(table(channels), BENCH, None).notes
    assert len(noted) == 1 and "pressure_b reaches" in noted[0] and "no mistake of wiring" in noted[0]


def test_repair_keeps_the_rest_of_a_map(runs: list[StateArray]) -> None:
    channels = scaled("valve_current", by=-1.0)(fields(runs[0]))
    columns = ColumnMap.load("time=t[ms],piston_position=pos[mm]-40,valve_current=i[mA],load_force=fl")
    held = {name: channels[name] for name in ("piston_position", "valve_current", "load_force")}
    with pytest.raises(WiringError) as raised:
        wiring_checked(table(held), BENCH, columns)
    repair = str(raised.value).split('--columns "')[1].split('"')[0]
    assert repair == "time=t[ms],piston_position=pos[mm]-40,valve_current=i[mA]*-1,load_force=fl"


def test_command_refuses_with_status_2_and_goes_on_as_wired(runs: list[StateArray], tmp_path: Path) -> None:
    wrong = table(scaled("load_force", by=-1.0)(fields(runs[0])))
    path = tmp_path / "run.csv"
    pd.DataFrame({"time": wrong.time, **wrong.columns}).to_csv(path, index=False)
    command = [sys.executable, "-m", "hydro_diagnosis.cli", str(path), "--out", str(tmp_path / "out")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: run: load_force ") and 'load_force=load_force*-1"' in ended.stderr
    assert not (tmp_path / "out").exists()
    assert len(load_dataset([path], [], BENCH, as_wired=True)[0]) == 1
    assert len(load_dataset([path], [], BENCH, ColumnMap.load("load_force=load_force*-1"))[0]) == 1


def test_bag_is_repaired_by_a_map_too(tmp_path: Path) -> None:
    (tmp_path / "truth.yaml").write_text(yaml.safe_dump({"profile": "nominal"}))
    words = ["--offline", "--truth", str(tmp_path / "truth.yaml"), "--seconds", "8", "--out", str(tmp_path / "bag")]
    run_emulator(words)
    states = read_bag(tmp_path / "bag").state
    turned = read_table(tmp_path / "bag", ColumnMap.load("valve_current=valve_current*-1"))
    np.testing.assert_array_equal(turned.columns["valve_current"], -states["valve_current"])
    assert turned.sample is not None
    with pytest.raises(WiringError, match=r"valve_current=valve_current\*-1"):
        columns = ColumnMap.load("valve_current=valve_current*-1,load_force=load_force")
        load_dataset([tmp_path / "bag"], [], BENCH, columns)


def extreme(entry: object, high: bool) -> object:
    if isinstance(entry, Size):
        return entry.neutral + entry.signs[-1 if high else 0] * entry.high
    if isinstance(entry, Shape):
        return entry.high if high else entry.low
    return entry.words[-1 if high else 0] if isinstance(entry, Pick) else entry


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_no_effect_of_the_table_is_taken_for_a_mistake(tmp_path: Path) -> None:
    """Every effect of the emulator at its largest, both signs, slow and fast references; also thinned and jittered."""
    references = [("sine", 280.0, 0.3, 20.0), ("multisine", 260.0, 0.6, 60.0)]
    cases = [Case(name=f"clean{k}", kind="clean", label="", noise=noise) for k, noise in enumerate((0.1, 1.0, 4.0))]
    for tables, where in ((SINGLES, "effects"), (VALUES, "effects"), (FORMS, "effects"), (OUTSIDE, "outside")):
        for name, entry in tables.items():
            for high in (False, True):
                drawn = {key: extreme(one, high) for key, one in entry.items()}
                case = Case(name=f"{name.replace('/', '-')}{high:d}", kind="single", label=name)
                cases.append(replace(case, **{where: {name.split("/")[0]: drawn}}))
    jobs = []
    for case in cases:
        (tmp_path / f"{case.name}.yaml").write_text(yaml.safe_dump(truth_of(case)))
        for kind, amplitude, frequency, kp in references:
            segment = {"waveform": kind, "amplitude": amplitude, "frequency": frequency, "kp": kp, "ki": 10.0}
            schedule = tmp_path / f"{kind}.yaml"
            schedule.write_text(yaml.safe_dump({"segments": [{"seconds": 8.0, "offset": 20.0, **segment}]}))
            truth, out = str(tmp_path / f"{case.name}.yaml"), str(tmp_path / f"{case.name}.{kind}")
            jobs.append({"out": out, "truth": truth, "schedule": str(schedule), "seed": len(jobs)})
    (tmp_path / "batch.yaml").write_text(yaml.safe_dump({"jobs": jobs}))
    run_emulator(["--offline", "--batch", str(tmp_path / "batch.yaml")])
    rng = np.random.default_rng(1)
    for job in jobs:
        states = read_bag(job["out"]).state
        for thinned in (1, 10):
            found = table(fields(states[::thinned]), 1e-3 * thinned)
            time = found.time + (rng.uniform(0.0, 3e-4, len(found.time)) if thinned > 1 else 0.0)
            told = mistakes(replace(found, time=time), BENCH)
            assert told is None, (job["out"], thinned, [one.sentence for one in told.complaints])
