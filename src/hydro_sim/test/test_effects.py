# SPDX-License-Identifier: Apache-2.0
"""A bench file, its effects among it: in the analytic plant as in the truth, refused where it cannot be."""

from __future__ import annotations

import re
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_core.signals import StateArray
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate


def test_wrong_numbers_are_put_right_within_their_ranges(bench: Bench) -> None:
    rest, dead = ({"position": 0.035}, {"ratio": 2.0})
    effects = ({"id": "spring_rest", "parameters": rest}, {"id": "dead_volume", "chamber": "b", "parameters": dead},
               {"id": "friction_viscous", "parameters": {"coefficient": -100.0}})  # fmt: skip
    found = replace(bench, effects=effects).constants()[0]
    numbers = ("spring_rest_position", "dead_volume_b", "viscous_friction")
    assert [found[name] for name in numbers] == pytest.approx([0.035, 4e-4, 0.0])


CASES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("transport_delay", {"time": 2e-3}, {}),
    ("valve_lag", {"bandwidth": 60.0, "damping": 0.9}, {}),
    ("valve_deadband", {"half_width": 1e-4}, {}),
    ("valve_underlap", {"half_width": 2e-4}, {}),
    ("valve_edge", {"overlap": 2e-4, "ratio": 0.8}, {"edge": "at"}),
    ("valve_edge", {"overlap": 0.0, "ratio": 0.7}, {"edge": "bt"}),
    ("valve_gain", {"ratio": 0.85}, {}),
    ("leakage_internal", {"coefficient": 3e-13}, {}),
    ("leakage_external", {"coefficient": 3e-13}, {"chamber": "a"}),
    ("leakage_external", {"coefficient": 3e-13}, {"chamber": "b"}),
    ("moving_mass", {"mass": 2.0}, {}),
    ("friction_viscous", {"coefficient": 100.0}, {}),
    ("spring_stiffness", {"ratio": 1.3}, {}),
    ("spring_rest", {"position": 0.045}, {}),
    ("load_cell_bias", {"force": 30.0}, {"cell": "load_force"}),
    ("pressure_sensor_bias", {"pressure": 2e5}, {"chamber": "a"}),
    ("friction_coulomb", {"force": 15.0}, {}),
    ("supply_droop", {"resistance": 5e10, "time_constant": 0.02}, {}),
    ("return_line", {"resistance": 2e11, "time_constant": 0.02}, {}),
    ("return_line", {"orifice": 1.5e-8, "time_constant": 0.02}, {"form": "orifice"}),
    ("supply_pump", {"flow_limit": 8e-6, "relief_pressure": 16e6, "volume": 5e-4, "leakage": 1e-13}, {}),
    ("oil_drift", {"rate": -0.05}, {}),
    ("entrained_air", {"volume_fraction": 0.02}, {}),
    ("load_cell_gain", {"ratio": 1.1}, {"cell": "load_force"}),
    ("sensor_lag", {"bandwidth": 20.0, "damping": 0.7}, {"sensor": "load_force"}),
    ("spring_hardening", {"coefficient": 2e7}, {}),
    ("backlash", {"width": 1e-3}, {"form": "play"}),
]
"""Id, parameters, options; the words are the same for the emulator and for a corrected.yaml."""


def rmse(states: StateArray) -> float:
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"])[1000:] ** 2)))


@pytest.mark.parametrize(("name", "parameters", "options"), CASES, ids=range(len(CASES)))
def test_tracking_error_is_that_of_the_truth(
    name: str, parameters: dict[str, Any], options: dict[str, Any], bench: Bench
) -> None:
    segment = Segment(seconds=4.0, waveform="sine", amplitude=250.0, kp=60.0, ki=10.0)
    truth = truth_from_mapping({"profile": "nominal", "effects": {name: {**parameters, **options}}})
    expected = rmse(record_offline(truth, [segment], seed=3).states)
    schedule = Schedule(reference=segment.signal, gains=(60.0, 10.0), seconds=4.0)
    corrected = replace(bench, effects=({"id": name, **options, "parameters": parameters},))
    simulated, left_out = (rmse(simulate(AnalyticPlant(one), bench, schedule)) for one in (corrected, bench))
    with_it, without = simulated / expected - 1.0, left_out / expected - 1.0
    print(f"{name}: truth {expected:.2f} N, with it {with_it:+.2%}, without {without:+.2%}")
    assert abs(with_it) < 0.01
    if abs(without) > 0.05:
        assert abs(with_it) < 0.1 * abs(without)


CLOSURE = {"equation": "motion", "form": "quadratic drg", "parameters": {}}
REFUSED: tuple[tuple[dict[str, object], str], ...] = (
    ({"bulk_modulos": 1e9}, "bench.bulk_modulos is not a known setting; did you mean bulk_modulus?"),
    ({"stroke": ...}, "bench lacks stroke [m]"),
    ({"stroke": -0.08}, "bench.stroke must be a number within [0.001, 5] m, not -0.08"),
    ({"moving_mass": nan}, "bench.moving_mass must be a number within [1e-06, 1e+07] kg, not nan"),
    ({"supply_pressure": 1e5, "tank_pressure": 2e5}, "is not below supply_pressure 100000 Pa"),
    ({"effects": [{"id": "gremlin"}]}, "effect 'gremlin' is not known"),
    ({"closures": [CLOSURE]}, "is not known; there is closure equation=motion form=quadratic drag, "),
    ({"effects": [{"id": "backlash"}]}, "effect backlash lacks its parameter width [m]"),
    ({"effects": [{"id": "backlash", "parameters": {"width": "wide"}}]}, "width = 'wide' is not a number in [0, 5]"),
)


def test_a_file_that_is_no_bench_is_refused_in_one_sentence_with_its_name_and_key(tmp_path: Path) -> None:
    path, nominal = tmp_path / "bench.yaml", Bench.nominal().to_mapping()
    for changes, sentence in REFUSED:
        content = {key: value for key, value in {**nominal, **changes}.items() if value is not ...}
        path.write_text(yaml.safe_dump(content))
        with pytest.raises(ValueError) as refusal:
            Bench.load(path)
        assert str(refusal.value).startswith(f"{path}: ") and sentence in str(refusal.value)
        assert len(str(refusal.value)) < 600
    for broken in (b"", b"- 1\n- 2\n", b"a: [1\n", b"\xff\xfe\x00"):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=re.escape(str(path))) as refusal:
            Bench.load(path)
        assert "\n" not in str(refusal.value)
