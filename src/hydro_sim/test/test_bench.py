# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from math import nan
from pathlib import Path

import pytest
import yaml

from hydro_sim.model.bench import Bench


def write(path: Path, **changes: object) -> Path:
    content = {**Bench.nominal().to_mapping(), **changes}
    path.write_text(yaml.safe_dump({key: value for key, value in content.items() if value is not ...}))
    return path


def test_effects_of_a_diagnosis_are_kept(tmp_path: Path) -> None:
    effects = [
        {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},
        {"id": "valve_deadband", "form": "soft", "parameters": {"half_width": 1e-3, "softness": 1e-4}},
    ]
    bench = Bench.load(write(tmp_path / "corrected.yaml", effects=effects))
    assert bench.effects == tuple(effects)
    assert bench.to_mapping()["effects"] == effects


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"bulk_modulos": 1e9}, "bench.bulk_modulos is not a known setting; did you mean bulk_modulus?"),
        ({"stroke": ...}, "bench lacks stroke [m]"),
        ({"stroke": -0.08}, "bench.stroke must be within [0.001, 5] m, not -0.08: L_c"),
        ({"moving_mass": nan}, "bench.moving_mass must be a number in kg, not nan"),
        (
            {"supply_pressure": 1e5, "tank_pressure": 2e5},
            "tank_pressure 200000 Pa is not below supply_pressure 100000 Pa",
        ),
        ({"effects": [{"parameters": {}}]}, "'effects' is a list of mappings, each with an 'id'"),
        ({"effects": [{"id": "gremlin"}]}, "effect 'gremlin' is not known"),
        ({"effects": [{"id": "backlash"}]}, "effect backlash lacks its parameter width [m]"),
        (
            {"effects": [{"id": "backlash", "parameters": {"width": "wide"}}]},
            "effect backlash: width = 'wide' is not a number in [0, 0.1] m",
        ),
        (
            {"effects": [{"id": "valve_offset", "parameters": {"current": 1e-3, "Current": 0}}]},
            "effect valve_offset has no parameter 'Current'",
        ),
    ],
)
def test_bad_bench_is_refused_in_one_sentence_with_file_and_key(
    changes: dict[str, object], sentence: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "bench.yaml", **changes)
    with pytest.raises(ValueError) as refusal:
        Bench.load(path)
    assert str(refusal.value) == f"{path}: {sentence}"


@pytest.mark.parametrize("content", [b"", b"- 1\n- 2\n", b"a: [1\n", b"\xff\xfe\x00"])
def test_what_is_no_bench_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(str(path))) as refusal:
        Bench.load(path)
    assert "\n" not in str(refusal.value)
