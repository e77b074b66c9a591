# SPDX-License-Identifier: Apache-2.0
"""The bench in other simulators: FMU, MuJoCo, Simulink and C do what the simulation does."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
import yaml
from fmpy.validation import validate_fmu

from hydro_core.signals import FloatArray, ReferenceSignal, Waveform
from hydro_sim.export import command
from hydro_sim.export.model import ExportedModel
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import READINGS
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.checks import compiled, status_of

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
SIMULINK_STUBS = f"-I{FIRMWARE / 'test' / 'simulink'}"


def effect(label: str, **parameters: float) -> dict[str, Any]:
    id, *options = label.split()
    return {"id": id, **dict(option.split("=") for option in options), "parameters": parameters}


SMOOTH = (
    effect("leakage_internal", coefficient=1e-13), effect("valve_deadband", half_width=3e-4),
    effect("supply_droop", resistance=1e9, time_constant=0.05), effect("entrained_air", volume_fraction=0.01),
    effect("load_cell_gain cell=load_force", ratio=1.03),
)  # fmt: skip
DRY = (effect("friction_coulomb", force=12.0), effect("friction_stribeck", breakaway_force=8.0, velocity=0.01))
LAGS = (
    effect("valve_lag", bandwidth=120.0, damping=0.8), effect("valve_lag form=first_order", bandwidth=300.0),
    effect("sensor_lag sensor=pressure_a", bandwidth=200.0, damping=0.7),
)  # fmt: skip
DELAY = effect("transport_delay", time=1.3e-3)
STEPPING = (
    *LAGS, DELAY, *DRY, effect("friction_presliding", stiffness=2e5), effect("backlash form=play", width=1e-3),
)  # fmt: skip
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 400.0}}
WARM = {"equation": "pressure", "form": "leak by past opening of the valve",
        "parameters": {"coefficient": 5e-11, "time": 2.0}}  # fmt: skip
NOMINAL = Bench.nominal()
BENCHES = {
    "textbook": NOMINAL,
    "dry friction": replace(NOMINAL, effects=(SMOOTH[0], *DRY)),
    "closures": replace(NOMINAL, effects=SMOOTH, closures=(DRAG, WARM)),
    "lags": replace(NOMINAL, load_cell_bandwidth=None, effects=(*LAGS, *SMOOTH)),
    "stepping": replace(NOMINAL, effects=STEPPING, closures=(DRAG,)),
}


class Run:
    """A second of `sim` without noise: currents [A] and readings in the order of READINGS, one row a millisecond."""

    def __init__(self, bench: Bench) -> None:
        reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
        schedule = Schedule(reference=reference, gains=(15.0, 5.0), seconds=1.0)
        states = simulate(AnalyticPlant(bench, noise=0.0), NOMINAL, schedule)
        self.currents = states["valve_current"].copy()
        self.readings = np.stack([states[name] for name in READINGS], axis=1)

    def worst(self, found: FloatArray, columns: Sequence[int] = range(5)) -> float:
        """Largest deviation, as a share of each output's range."""
        off = np.abs(found - self.readings) / np.ptp(self.readings, axis=0)
        return float(off[:, list(columns)].max())


@cache
def expected(name: str) -> Run:
    return Run(BENCHES[name])


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fmus")
    files = {name: folder / f"{name.replace(' ', '_')}.fmu" for name in BENCHES}
    for name, file in files.items():
        file.write_bytes(ExportedModel(BENCHES[name]).fmu(file.stem))
    return files


def simulated(file: Path, kind: str, currents: FloatArray, **more: Any) -> FloatArray:
    """Readings of an FMU at each millisecond, the currents held; by fmpy."""
    time, samples = np.arange(len(currents)) * 1e-3, [("time", float), ("valve_current", float)]
    held = np.zeros(2 * len(time) - 1, samples)
    held["time"], held["valve_current"] = np.repeat(time, 2)[1:], np.repeat(currents, 2)[:-1]
    if kind == "CoSimulation":  # a step holds what it is given
        held = np.array([*zip(time, currents, strict=True)], samples)
    found = fmpy.simulate_fmu(
        str(file), fmi_type=kind, stop_time=time[-1], output_interval=1e-3, input=held, output=READINGS, **more
    )
    return np.stack([np.interp(time, found["time"], found[name]) for name in READINGS], axis=1)


@pytest.mark.parametrize("name", BENCHES)
def test_an_fmu_is_the_simulation_by_its_own_steps_and_by_a_solver(fmus: dict[str, Path], name: str) -> None:
    assert validate_fmu(str(fmus[name])) == []
    run = expected(name)
    assert run.worst(simulated(fmus[name], "CoSimulation", run.currents)) < 1e-9
    if name != "stepping":
        solved = simulated(fmus[name], "ModelExchange", run.currents, relative_tolerance=1e-8)
        assert run.worst(solved) < 1e-4


def test_the_command_exports_units_bounds_and_intervals_that_act_and_says_what_moves_by_whole_steps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench, file = BENCHES["stepping"], tmp_path / "bench.fmu"
    (tmp_path / "corrected.yaml").write_text(yaml.safe_dump(bench.to_mapping()))
    found = [{"id": "friction_coulomb", "parameters": {"force": {"value": 12.0, "ci95": [11.5, 12.5], "unit": "N"}}}]
    (tmp_path / "report.json").write_text(json.dumps({"effects": found, "closures": [], "estimated": []}))
    assert status_of(command.main, "--fmu", file, "--bench", tmp_path / "corrected.yaml") == 0
    said = "co-simulation only: friction_presliding, backlash form=play, transport_delay move on by whole steps"
    assert said in capsys.readouterr().out
    description = fmpy.read_model_description(str(file))
    assert description.modelExchange is None
    variables = {one.name: one for one in description.modelVariables}
    force = variables["friction_coulomb.force"]
    assert (force.unit, float(force.min), float(force.max), float(force.start)) == ("N", 0.0, 1e8, 12.0)
    assert variables["bench.spring_stiffness"].unit == "N/m"
    with zipfile.ZipFile(file) as archive:
        assert archive.read("modelDescription.xml").decode().count('"hydro.ci95">11.5 12.5<') == 1
    stiff, level = 2.5e4, 20.0
    effects = [effect("friction_coulomb", force=level) if one == DRY[0] else one for one in STEPPING]
    run = Run(replace(bench, spring_stiffness=stiff, effects=tuple(effects)))
    start = {"bench.spring_stiffness": stiff, "friction_coulomb.force": level}
    assert run.worst(simulated(file, "CoSimulation", run.currents, start_values=start)) < 1e-9


def test_an_fmu_refuses_in_a_sentence_and_begins_where_it_is_told(fmus: dict[str, Path], tmp_path: Path) -> None:
    description = fmpy.read_model_description(str(fmus["dry friction"]))
    places = {one.name: one.valueReference for one in description.modelVariables}
    said: list[str] = []
    folder = fmpy.extract(str(fmus["dry friction"]), unzipdir=str(tmp_path))
    fmu = fmpy.instantiate_fmu(
        folder, description, "CoSimulation", logger=lambda _, status, category, text: said.append(text.decode())
    )

    def put(name: str, value: float) -> None:
        fmu.setFloat64([places[name]], [value])

    def get(name: str) -> float:
        return float(fmu.getFloat64([places[name]])[0])

    fmu.enterInitializationMode()
    assert get("state.piston_position") == 0.04
    put("bench.spring_rest_position", 0.03)
    assert get("state.piston_position") == 0.03, "a still bench with these parameters"
    put("state.piston_position", 0.035)
    assert get("piston_position") == pytest.approx(0.035) and get("load_force") == pytest.approx(2e4 * 5e-3)
    refusals = {
        "friction_coulomb.force = -1 is not within [0, 1e+08] N": lambda: put("friction_coulomb.force", -1.0),
        "is given nan, which is no finite number": lambda: put("valve_current", float("nan")),
        "cannot be set": lambda: put("hydraulic_force", 1.0),
        "a step of 7e-05 s is not a multiple of the model's, 5e-05 s": lambda: fmu.doStep(0.0, 7e-5),
        "cannot be set any more": lambda: put("bench.stroke", 0.1),
    }
    for sentence, refused in refusals.items():
        if "step" in sentence:
            fmu.exitInitializationMode()
        with pytest.raises(Exception, match="status 3"):
            refused()
        assert sentence in said[-1]


@pytest.mark.parametrize("name", ["textbook", "stepping"])
def test_its_sources_compile_elsewhere(fmus: dict[str, Path], name: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(fmus[name]) as archive:
        archive.extract("sources/fmu.c", tmp_path)
        (binary,) = [one for one in archive.namelist() if one.startswith("binaries/")]
        archive.extract(binary, tmp_path)
    compiled(tmp_path / "sources" / "fmu.c", tmp_path / "fmu.o", "-O0", "-c", "-pedantic")
    needed = subprocess.run(["readelf", "-d", tmp_path / binary], capture_output=True, text=True, check=True).stdout
    libraries = [line.split("[")[1].split("]")[0] for line in needed.splitlines() if "NEEDED" in line]
    assert set(libraries) <= {"libm.so.6", "libc.so.6"}


def test_the_same_effect_twice_has_names_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "bench.fmu"
    file.write_bytes(ExportedModel(replace(NOMINAL, effects=(LAGS[0], LAGS[0]))).fmu(file.stem))
    names = [one.name for one in fmpy.read_model_description(str(file)).modelVariables]
    assert len(set(names)) == len(names) and {"valve_lag.damping[2]", "state.valve_lag.spool[2]"} <= set(names)


def numbers(array: FloatArray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def test_the_s_function_is_the_simulation(tmp_path: Path) -> None:
    run, source, exported = expected("stepping"), tmp_path / "bench_sfun.c", ExportedModel(BENCHES["stepping"])
    source.write_text(exported.simulink("bench_sfun"))
    library = compiled(source, tmp_path / "block.so", "-O1", "-shared", "-fPIC", SIMULINK_STUBS)
    block = ctypes.CDLL(str(library)).run_block
    block.restype = ctypes.c_char_p
    found = np.zeros_like(run.readings)

    def run_block(parameters: FloatArray) -> bytes | None:
        size = ctypes.c_size_t(len(parameters))
        return block(numbers(parameters), size, ctypes.c_long(len(found)), numbers(run.currents), numbers(found))

    assert run_block(np.empty(0)) is None
    assert run.worst(found) < 1e-9
    assert b"or a number for each of HYDRO_PARAMETER" in (run_block(np.ones(3)) or b"")
    values = exported.model.values.copy()
    values[0] *= 2.0
    assert run_block(values) is None
    assert run.worst(found) > 1e-3, "another bulk modulus"


def test_the_box_as_an_s_function_compiles(tmp_path: Path) -> None:
    assert status_of(command.main, "--box", tmp_path / "box_config.h") == 0
    source, places = FIRMWARE / "simulink" / "hydro_box_sfun.c", (f"-I{FIRMWARE}", SIMULINK_STUBS, f"-I{tmp_path}")
    compiled(source, tmp_path / "box.o", "-O0", "-c", *places)


def test_the_model_in_c_is_the_simulation(tmp_path: Path) -> None:
    run, source = expected("closures"), tmp_path / "bench.c"
    source.write_text(ExportedModel(BENCHES["closures"]).c_source())
    code = ctypes.CDLL(str(compiled(source, tmp_path / "bench.so", "-O1", "-shared", "-fPIC")))
    bench, found = ctypes.create_string_buffer(20_000), np.zeros_like(run.readings)
    code.hydro_bench_start(bench, None, None)
    for k, current in enumerate(run.currents):
        code.hydro_bench_read(bench, numbers(found[k]))
        code.hydro_bench_advance(bench, ctypes.c_double(current), ctypes.c_long(20))
    assert run.worst(found) < 1e-9


@pytest.fixture(scope="module")
def hinge() -> Any:
    os.environ.setdefault("MUJOCO_GL", "disable")
    from docs.examples import cylinder_on_a_hinge

    return cylinder_on_a_hinge


@pytest.mark.parametrize(
    ("effects", "timestep", "allowed"),
    [((*SMOOTH, LAGS[0], DELAY), 1e-3, 2e-3), (DRY, 1e-3, 0.05), (DRY, 1e-4, 0.01)],
)
def test_a_cylinder_on_a_hinge_does_what_the_bench_does(
    hinge: Any, tmp_path: Path, effects: tuple[dict[str, Any], ...], timestep: float, allowed: float
) -> None:
    bench, file = replace(NOMINAL, effects=effects), tmp_path / "cylinder.py"
    file.write_text(ExportedModel(bench).mujoco())
    run, exported = Run(bench), hinge.load(file)
    found = np.concatenate([run.readings[:1], hinge.simulate(exported, run.currents[:-1], timestep)])
    assert run.worst(found, (0, 2, 3, 4)) < allowed
