# SPDX-License-Identifier: Apache-2.0
"""Certified regions: the shipped statements are proved, and false ones refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.regions.statement import RegionTarget, unproved_statement
from benchmarks.verify_region import verify
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

NAMES = ("paper", "compensated")
FOLDER = Path(__file__).parents[1] / "regions"


def content_of(name: str) -> dict[str, Any]:
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def shortened(name: str) -> dict[str, Any]:
    """The statement of the last two gains alone: a proof of a part, in a part of the time."""
    part = content_of(name)
    for cell in part["cells"]:
        cell["gains"], cell["matrices"] = cell["gains"][-2:], cell["matrices"][-2:]
        part["proportional_gain"] = cell["gains"]
    return part


@pytest.mark.parametrize("name", NAMES)
def test_a_part_of_the_statement_is_proved(name: str) -> None:
    assert verify(shortened(name)) == ""


def test_half_of_lambda_is_accepted_and_false_statements_are_refused() -> None:
    half, wide, bent = (shortened(NAMES[0]) for _ in range(3))
    half["contraction_rate"] *= 0.5
    assert verify(half) == ""
    half["tolerances"]["valve_gain"] = [1.0, 1.04]
    assert "tolerances" in verify(half)
    wide["tolerances"]["valve_gain"] = wide["cells"][0]["tolerances"]["valve_gain"] = [1.0, 1.04]
    for matrix in bent["cells"][0]["matrices"]:
        matrix[3][3] *= 1.3
    assert verify(wide) != "" != verify(bent)


def target(name: str) -> RegionTarget:
    content = content_of(name)
    law = BoxConfig().of_bench(Bench.nominal()).compensated if name == "compensated" else None
    return RegionTarget(
        law=law, rate=content["contraction_rate"], force=content["facts"]["force"] / 300.0,
        gains=tuple(content["cells"][0]["gains"]), gain_rate=content["gain_rate"],
    )  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_the_statement_is_of_the_shipped_bench(name: str) -> None:
    content = content_of(name)
    made, _ = unproved_statement(load_model(), Bench.nominal(), target(name))
    made = json.loads(json.dumps(made)) | {key: content[key] for key in ("tube", "cells", "facts", "assumed")}
    states = made.pop("states"), content.pop("states")
    assert made == content
    for state, (low, high) in states[0].items():
        np.testing.assert_allclose((low, high), states[1][state], rtol=1e-3)
