# SPDX-License-Identifier: Apache-2.0
"""The bench in other simulators: FMU, MuJoCo, Simulink and C do what the simulation does."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
import yaml
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from hydro_core.signals import FloatArray, ReferenceSignal, Waveform
from hydro_sim.export import command
from hydro_sim.export.model import ExportedModel
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import catalogue
from hydro_sim.model.equations import READINGS
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.checks import compiled, each, status_of

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 1.0


def effect(id: str, parameters: Mapping[str, float], **options: str) -> dict[str, Any]:
    return {"id": id, **options, "parameters": parameters}


SMOOTH = (
    effect("leakage_internal", {"coefficient": 1e-13}), effect("valve_deadband", {"half_width": 3e-4}),
    effect("supply_droop", {"resistance": 1e9, "time_constant": 0.05}),
    effect("entrained_air", {"volume_fraction": 0.01}), effect("load_cell_gain", {"ratio": 1.03}, cell="load_force"),
)  # fmt: skip
DRY = (
    effect("friction_coulomb", {"force": 12.0}),
    effect("friction_stribeck", {"breakaway_force": 8.0, "velocity": 0.01}),
)
LAGS = (
    effect("valve_lag", {"bandwidth": 120.0, "damping": 0.8}),
    effect("valve_lag", {"bandwidth": 300.0}, form="first_order"),
    effect("sensor_lag", {"bandwidth": 200.0, "damping": 0.7}, sensor="pressure_a"),
)
STEPPING = (
    *LAGS, effect("transport_delay", {"time": 1.3e-3}), *DRY, effect("friction_presliding", {"stiffness": 2e5}),
    effect("backlash", {"width": 1e-3}, form="play"),
)  # fmt: skip
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 400.0}}
WARM = {"equation": "pressure", "form": "leak by past opening of the valve",
        "parameters": {"coefficient": 5e-11, "time": 2.0}}  # fmt: skip
NOMINAL = Bench.nominal()
BENCHES = {
    "textbook": NOMINAL,
    "ideal cell": replace(NOMINAL, load_cell_bandwidth=None, effects=SMOOTH),
    "dry friction": replace(NOMINAL, effects=(SMOOTH[0], *DRY)),
    "closures": replace(NOMINAL, effects=SMOOTH, closures=(DRAG, WARM)),
    "lags": replace(NOMINAL, load_cell_bandwidth=None, effects=(*LAGS, *SMOOTH)),
    "stepping": replace(NOMINAL, effects=STEPPING, closures=(DRAG,)),
}


@dataclass(frozen=True)
class Run:
    """A run of `sim` without noise: currents [A] and readings in the order of READINGS, one row a millisecond."""

    currents: FloatArray
    readings: FloatArray

    def worst(self, found: FloatArray, columns: Sequence[int] = range(5)) -> float:
        """Largest deviation, as a share of each output's range."""
        off = np.abs(found - self.readings) / np.ptp(self.readings, axis=0)
        return float(off[:, list(columns)].max())


def run_of(bench: Bench, seconds: float = SECONDS) -> Run:
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
    schedule = Schedule(reference=reference, gains=(15.0, 5.0), seconds=seconds)
    states = simulate(AnalyticPlant(bench, noise=0.0), NOMINAL, schedule)
    return Run(states["valve_current"].copy(), np.stack([states[name] for name in READINGS], axis=1))


@cache
def expected(name: str) -> Run:
    return run_of(BENCHES[name])


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
def test_a_co_simulation_is_the_simulation(fmus: dict[str, Path], name: str) -> None:
    assert validate_fmu(str(fmus[name])) == []
    run = expected(name)
    found = simulated(fmus[name], "CoSimulation", run.currents)
    print(f"{name}: {run.worst(found):.1g} of the range")
    assert run.worst(found) < 1e-9


@pytest.mark.parametrize("name", [name for name in BENCHES if name != "stepping"])
def test_a_solver_of_its_own_finds_the_same(fmus: dict[str, Path], name: str) -> None:
    run = expected(name)
    found = simulated(fmus[name], "ModelExchange", run.currents, relative_tolerance=1e-8)
    print(f"{name}: {run.worst(found):.1g} of the range")
    assert run.worst(found) < 1e-4


def test_no_solver_of_its_own_where_only_steps_move_a_state_on(
    fmus: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fmpy.read_model_description(str(fmus["stepping"])).modelExchange is None
    (tmp_path / "corrected.yaml").write_text(yaml.safe_dump(BENCHES["stepping"].to_mapping()))
    words = ("--fmu", tmp_path / "bench.fmu", "--bench", tmp_path / "corrected.yaml")
    assert status_of(command.main, *words) == 0
    said = "co-simulation only: friction_presliding, backlash form=play, transport_delay move on by whole steps"
    assert said in capsys.readouterr().out


def test_parameters_have_units_bounds_and_intervals_and_act(tmp_path: Path) -> None:
    bench = BENCHES["dry friction"]
    (tmp_path / "corrected.yaml").write_text(yaml.safe_dump(bench.to_mapping()))
    estimate = {"value": 12.0, "ci95": [11.5, 12.5], "unit": "N"}
    found = [{"id": "friction_coulomb", "parameters": {"force": estimate}}]
    (tmp_path / "report.json").write_text(json.dumps({"effects": found, "closures": [], "estimated": []}))
    file = tmp_path / "bench.fmu"
    assert status_of(command.main, "--fmu", file, "--bench", tmp_path / "corrected.yaml") == 0
    variables = {one.name: one for one in fmpy.read_model_description(str(file)).modelVariables}
    force = variables["friction_coulomb.force"]
    assert (force.unit, float(force.min), float(force.max), float(force.start)) == ("N", 0.0, 1e8, 12.0)
    assert variables["bench.spring_stiffness"].unit == "N/m"
    with zipfile.ZipFile(file) as archive:
        assert archive.read("modelDescription.xml").decode().count('"hydro.ci95">11.5 12.5<') == 1
    stiff, level = 2.5e4, 20.0
    changed = (SMOOTH[0], effect("friction_coulomb", {"force": level}), DRY[1])
    run = run_of(replace(NOMINAL, spring_stiffness=stiff, effects=changed))
    start = {"bench.spring_stiffness": stiff, "friction_coulomb.force": level}
    assert run.worst(simulated(file, "CoSimulation", run.currents, start_values=start)) < 1e-9


class Slave:
    """An instance of a co-simulation, and what it says."""

    def __init__(self, file: Path, folder: Path) -> None:
        description = fmpy.read_model_description(str(file))
        self.references = {one.name: one.valueReference for one in description.modelVariables}
        self.said: list[str] = []
        fmpy.extract(str(file), unzipdir=str(folder))
        self.fmu = FMU3Slave(
            guid=description.guid, unzipDirectory=str(folder), modelIdentifier=file.stem, instanceName="one"
        )
        log = fmpy.fmi3.fmi3LogMessageCallback(lambda _, status, category, text: self.said.append(text.decode()))
        self.fmu.instantiate(logMessage=log)
        self.fmu.enterInitializationMode()

    def set(self, **values: float) -> None:
        names = [name.replace("__", ".") for name in values]
        self.fmu.setFloat64([self.references[name] for name in names], list(values.values()))

    def get(self, *names: str) -> list[float]:
        return self.fmu.getFloat64([self.references[name] for name in names])


def test_it_refuses_in_a_sentence_and_begins_where_it_is_told(fmus: dict[str, Path], tmp_path: Path) -> None:
    slave = Slave(fmus["dry friction"], tmp_path)
    assert slave.get("state.piston_position") == [0.04]
    slave.set(bench__spring_rest_position=0.03)
    assert slave.get("state.piston_position") == [0.03], "a still bench with these parameters"
    slave.set(state__piston_position=0.035)
    assert slave.get("piston_position", "load_force") == pytest.approx([0.035, 2e4 * 5e-3])
    refusals = {
        "friction_coulomb.force = -1 is not within [0, 1e+08] N": lambda: slave.set(friction_coulomb__force=-1.0),
        "is given nan, which is no finite number": lambda: slave.set(valve_current=float("nan")),
        "cannot be set": lambda: slave.set(hydraulic_force=1.0),
        "a step of 7e-05 s is not a multiple of the model's, 5e-05 s": lambda: slave.fmu.doStep(0.0, 7e-5),
        "cannot be set any more": lambda: slave.set(bench__stroke=0.1),
    }
    for sentence, refused in refusals.items():
        if "step" in sentence:
            slave.fmu.exitInitializationMode()
        with pytest.raises(Exception, match="status 3"):
            refused()
        assert sentence in slave.said[-1]


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


def test_a_name_that_c_refuses_and_a_folder_that_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(command.main, "--simulink", tmp_path / "bänk.c") == 2
    assert "made of letters, digits and _" in capsys.readouterr().err
    assert status_of(command.main, "--c", tmp_path / "none" / "bench.c") == 2
    assert capsys.readouterr().err == f"error: {tmp_path}/none/bench.c: No such file or directory\n"


def numbers(array: FloatArray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def test_the_s_function_is_the_simulation(tmp_path: Path) -> None:
    run, source = expected("stepping"), tmp_path / "bench_sfun.c"
    source.write_text(ExportedModel(BENCHES["stepping"]).simulink("bench_sfun"))
    stubs = f"-I{ROOT / 'firmware' / 'test' / 'simulink'}"
    block = ctypes.CDLL(str(compiled(source, tmp_path / "block.so", "-O1", "-shared", "-fPIC", stubs))).run_block
    block.restype = ctypes.c_char_p
    found = np.zeros_like(run.readings)

    def run_block(parameters: FloatArray) -> bytes | None:
        size = ctypes.c_size_t(len(parameters))
        return block(numbers(parameters), size, ctypes.c_long(len(found)), numbers(run.currents), numbers(found))

    assert run_block(np.empty(0)) is None
    assert run.worst(found) < 1e-9
    assert b"or a number for each of HYDRO_PARAMETER" in (run_block(np.ones(3)) or b"")
    values = ExportedModel(BENCHES["stepping"]).model.values.copy()
    values[0] *= 2.0
    assert run_block(values) is None
    assert run.worst(found) > 1e-3, "another bulk modulus"


def test_the_box_as_an_s_function_compiles(tmp_path: Path) -> None:
    assert status_of(command.main, "--box", tmp_path / "box_config.h") == 0
    places = (f"-I{ROOT / 'firmware'}", f"-I{ROOT / 'firmware' / 'test' / 'simulink'}", f"-I{tmp_path}")
    compiled(ROOT / "firmware" / "simulink" / "hydro_box_sfun.c", tmp_path / "box.o", "-O0", "-c", *places)


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
    [((*SMOOTH, LAGS[0], STEPPING[3]), 1e-3, 2e-3), (DRY, 1e-3, 0.05), (DRY, 1e-4, 0.01)],
)
def test_a_cylinder_on_a_hinge_does_what_the_bench_does(
    hinge: Any, tmp_path: Path, effects: tuple[dict[str, Any], ...], timestep: float, allowed: float
) -> None:
    bench, file = replace(NOMINAL, effects=effects), tmp_path / "cylinder.py"
    file.write_text(ExportedModel(bench).mujoco())
    run, exported = run_of(bench), hinge.load(file)
    found = np.concatenate([run.readings[:1], hinge.simulate(exported, run.currents[:-1], timestep)])
    print(f"{timestep:g} s: {run.worst(found, (0, 2, 3, 4)):.2g} of the range")
    assert run.worst(found, (0, 2, 3, 4)) < allowed


def test_an_actuator_that_does_not_suit_is_refused(hinge: Any, tmp_path: Path) -> None:
    file = tmp_path / "cylinder.py"
    file.write_text(ExportedModel(NOMINAL).mujoco())
    exported = hinge.load(file)
    scene = hinge.SCENE.format(timestep=1e-3, mass=1.0, stiffness=1.0, softness=2e-3)
    cases = {
        "a timestep of 0.00033 s is not a multiple": (scene.replace('timestep="0.001"', 'timestep="0.00033"'), None),
        "mj_step2 has no RK4": (scene.replace("<option", '<option integrator="RK4"'), None),
        "with a gear of 1": (scene.replace('tendon="rod"/>', 'tendon="rod" gear="2"/>'), None),
        "there is no parameter bench.mass": (scene, {"bench.mass": 1.0}),
    }
    for sentence, (text, parameters) in cases.items():
        with pytest.raises(ValueError, match=sentence):
            exported.Cylinder(hinge.mujoco.MjModel.from_xml_string(text), "cylinder", parameters=parameters)


@pytest.mark.study
def test_every_effect_of_the_table_is_exported(tmp_path: Path) -> None:
    def check(label: str) -> None:
        kind = catalogue.CATALOGUE[label]
        values = {one.name: one.neutral for one in kind.parameters}
        entry = {"id": kind.effect.id, **dict(kind.chosen), "parameters": values}
        file = tmp_path / "bench.fmu"
        file.write_bytes(ExportedModel(replace(NOMINAL, effects=(entry,))).fmu(file.stem))
        assert validate_fmu(str(file)) == []

    each(sorted(catalogue.CATALOGUE), check)
