# SPDX-License-Identifier: Apache-2.0
"""The filter's loop of a bench file."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.metric.design import rest_loop
from hydro_filter.model.loop import effects_to_compile, loop_of, memories, rest_measurement
from hydro_filter.model.observer import follow, settle
from hydro_filter.model.state import POSITION, VELOCITY
from hydro_filter.model.terms import hidden_state_numbers
from hydro_sim.compilations import VARIABLE, read_compilations
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.grammar import LAWS
from hydro_sim.model.laws import Law

Entry = dict[str, Any]
LAG: Entry = {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}}
LEAK: Entry = {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}}


def of(*effects: dict[str, object]) -> Bench:
    return Bench.from_mapping(Bench.nominal().to_mapping() | {"effects": list(effects)})


@pytest.mark.parametrize(
    "disturbance",
    [
        {"id": "friction_coulomb", "parameters": {"force": 12.0}},
        {"id": "valve_deadband", "parameters": {"half_width": 5e-4}},
    ],
)
def test_bounded_disturbances_are_no_part_of_the_linearized_loop(bench: Bench, disturbance: dict[str, object]) -> None:
    for with_it, without in zip(
        rest_loop(loop_of(of(LAG, disturbance), bench), 60.0), rest_loop(loop_of(of(LAG), bench), 60.0), strict=True
    ):
        assert np.array_equal(with_it, without)


def test_sensors_that_are_off_and_a_shifted_null_leave_the_still_loop_as_it_is(bench: Bench) -> None:
    """The design point is the still bench as these sensors show it, its valve closed by the current that this takes."""
    shift = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    off = [
        {"id": "load_cell_bias", "cell": "load_force", "parameters": {"force": 40.0}},
        {"id": "load_cell_bias", "cell": "hydraulic_force", "parameters": {"force": -30.0}},
        {"id": "pressure_sensor_bias", "chamber": "a", "parameters": {"pressure": 2e5}},
        {"id": "pressure_sensor_bias", "chamber": "b", "parameters": {"pressure": -2e5}},
    ]
    plain, shown = loop_of(of(LAG, LEAK), bench), loop_of(of(shift, LAG, LEAK, *off), bench)
    x = rest_measurement(shown.model)
    _, _, readings = (model := BenchModel(of(shift, LAG, LEAK, *off))).begin(model.values)
    assert x[[0, 2, 4, 5, 6]] == pytest.approx(readings)
    for ours, theirs in zip(rest_loop(shown, 60.0)[:2], rest_loop(plain, 60.0)[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("law", [law for law in LAWS if law.element is not None], ids=lambda law: law.form)
def test_a_closure_that_remembers_is_refused_in_a_sentence(law: Law) -> None:
    with pytest.raises(ValueError, match=f"no place for what closures remember: take {law.form} out"):
        loop_of(replace(Bench.nominal(), closures=(_entry(law),)), Bench.nominal())


def _entry(law: Law) -> dict[str, object]:
    numbers = {one.name: one.probes[0] for one in law.numbers}
    return {"equation": law.equation, "form": law.form, "parameters": {"coefficient": law.typical, **numbers}}


def test_what_is_compiled_hangs_on_the_effects_and_not_on_their_numbers(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    loop_of(of(LAG, LEAK), bench)
    assert effects_to_compile(of(LAG, LEAK)) == ""
    capfd.readouterr()
    other = [{**one, "parameters": {**one["parameters"], name: value}} for one, name, value in (
        (LAG, "bandwidth", 90.0), (LEAK, "coefficient", 2e-13))]  # fmt: skip
    assert effects_to_compile(of(*other)) == ""
    loop_of(of(*other), replace(bench, spring_stiffness=3e4))
    assert "compiling" not in capfd.readouterr().err
    loop_of(load_model(), bench)
    assert FilterChoice(bench=bench).uncompiled == ""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert effects_to_compile(of(LAG, LEAK)) == "valve_lag, leakage_internal"
    file = tmp_path / "bench.yaml"
    file.write_text(yaml.safe_dump(of(LAG, LEAK).to_mapping()), encoding="utf-8")
    choice = FilterChoice(bench=bench, model=file)
    assert choice.uncompiled == "the model of a bench with valve_lag, leakage_internal"


@pytest.mark.slow
def test_the_filter_on_a_bench_file_as_set_up_compiles_it_compiles_nothing(tmp_path: Path) -> None:
    """Neither a kernel, whatever the numbers, nor a model."""
    code = (
        "from dataclasses import replace; from hydro_filter import precompile; from hydro_sim.model.bench import Bench;"
        "precompile.Bench = type('B', (), {'nominal': lambda: replace(Bench.nominal(), spring_stiffness=3e4)});"
        "precompile._bench_file()"
    )
    environment = {**os.environ, VARIABLE: str(tmp_path / "log")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert read_compilations(tmp_path / "log") == [] and done.stderr == ""


def test_bristles_bend_by_the_motion_that_was_measured() -> None:
    """Closed form of a steady motion, although the forces at hand would throw the mass off within a sample."""
    coulomb, breakaway, width, stiffness, speed, count = 12.0, 45.0, 0.01, 5e5, 1e-3, 100
    numbers = (
        ("friction_coulomb", {"force": coulomb}),
        ("friction_stribeck", {"breakaway_force": breakaway, "velocity": width}),
        ("friction_presliding", {"stiffness": stiffness}),
    )
    model = of(*({"id": name, "parameters": each} for name, each in numbers))
    loop, memory = loop_of(model, model), memories()[0]
    x = rest_measurement(loop.model)
    x[VELOCITY] = speed
    for _ in range(count):
        settle(loop, memory, x, 0.0, 0.0)
        follow(loop, memory, x, 0.0, 0.0)
        x[POSITION] += speed * SAMPLE_PERIOD
    bent = memory["hidden"][hidden_state_numbers(model)["friction_presliding", 0, "bent"]]
    level = coulomb + breakaway * np.exp(-((speed / width) ** 2))
    moved = count * speed * SAMPLE_PERIOD
    assert bent == pytest.approx(level * (1.0 - np.exp(-stiffness * moved / level)), rel=1e-3)
