# SPDX-License-Identifier: Apache-2.0
"""A held-out window that the model itself cannot predict says nothing; a wrong model's error stays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import StateArray, Waveform
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.problem import sensor_noise
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.validation import HORIZON, MOST, Comparison, compare
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
RISE = {"breakaway_force": 8.0, "velocity": 0.012}
"""Stribeck friction without any other: the piston stops and breaks loose by tenths of a newton."""


def stribeck(**values: float) -> Claim:
    return Claim(next(one for one in LIBRARY if one.label == "friction_stribeck"), {**RISE, **values})


@pytest.fixture(scope="module")
def held(record: Callable[..., StateArray]) -> SegmentModel:
    truth = replace(BENCH, effects=({"id": "friction_stribeck", "parameters": RISE},))
    states = record(truth, 11, seconds=25.0, waveform=Waveform.SMOOTH_STEP)
    table = RawTable("steps", states["time"].copy(), None, {name: states[name].copy() for name in states.dtype.names})
    return SegmentModel(checked(table, BENCH).segments[0], BENCH)


def against_nothing(held: SegmentModel, claims: list[Claim]) -> Comparison:
    return compare([held], (), claims, sensor_noise([held]), seconds=HORIZON, windows=48, shooting=True)


def worst(comparison: Comparison, which: str) -> float:
    return max(getattr(error, which) / error.noise_floor for error in comparison.channels.values())


def test_true_model_is_at_the_noise_where_it_can_predict(held: SegmentModel) -> None:
    found = against_nothing(held, [stribeck()])
    assert found.left_out and len(found.left_out) <= MOST * found.windows
    assert worst(found, "rmse_after") < 1.15 < 3.0 < worst(found, "rmse_after_all")
    assert all(window.recording == "steps" and 0.0 < window.start < 25.0 for window in found.left_out)


@pytest.mark.parametrize("claims", [[], [stribeck(breakaway_force=2.0)]], ids=["no friction", "too little friction"])
def test_error_of_a_wrong_model_stays(held: SegmentModel, claims: list[Claim]) -> None:
    found = against_nothing(held, claims)
    assert worst(found, "rmse_after") > 0.8 * worst(found, "rmse_after_all") > 5.0


def test_nothing_is_left_out_where_nothing_sticks(nominal: StateArray) -> None:
    columns = {name: nominal[name].copy() for name in nominal.dtype.names}
    model = SegmentModel(checked(RawTable("run", nominal["time"].copy(), None, columns), BENCH).segments[0], BENCH)
    soft = Claim(next(one for one in LIBRARY if one.id == "friction_viscous").adapted(BENCH), {"coefficient": 60.0})
    found = against_nothing(model, [soft])
    assert not found.left_out
    for error in found.channels.values():
        np.testing.assert_equal((error.rmse_before, error.rmse_after), (error.rmse_before_all, error.rmse_after_all))
    assert worst(found, "rmse_after") > 2.0
