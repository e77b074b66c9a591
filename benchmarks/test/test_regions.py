# SPDX-License-Identifier: Apache-2.0
"""Certified regions: the statements are proved, points of the region agree, and lies are refused."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.regions.statement import RegionTarget, certify_region, unproved_statement
from benchmarks.verify_region import I, sample, verify
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

T = SAMPLE_PERIOD
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


def drawn_loops(content: dict[str, Any], count: int, side: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """K_p and F + G K at points of the region, shapes (count,) and (count, n, n); `side`: of the spool, 0 for both.

    The exponential of the rates that the bench's equations have at the point, without intervals.
    """
    rng, b, law = np.random.default_rng(0), content["bench"], content["believed"]
    state = {name: rng.uniform(low, high, count) for name, (low, high) in content["states"].items()}
    of = {name: rng.uniform(low, high, count) for name, (low, high) in content["tolerances"].items()}
    if side:
        state["opening"] = side * np.abs(state["opening"])
    area, area_b = b["piston_area"], b["piston_area"] * b["area_ratio"]
    x, s, p_a, p_b = (state[name] for name in ("position", "opening", "pressure_a", "pressure_b"))
    out, nominal = s > 0.0, np.abs(s) + state["opening_error"] * np.sign(s)

    def chambers(n: Mapping[str, Any]) -> tuple[FloatArray, ...]:
        """Stiffness, gain of the flow, its slope by the force, leak."""
        volume_a, volume_b = n["dead_volume_a"] + area * x, n["dead_volume_b"] + area_b * (b["stroke"] - x)
        drop_a = np.where(out, n["supply_pressure"] - p_a, p_a - b["tank_pressure"])
        drop_b = np.where(out, p_b - b["tank_pressure"], n["supply_pressure"] - p_b)
        stiff_a, stiff_b, k_v = n["bulk_modulus"] / volume_a, n["bulk_modulus"] / volume_b, n["valve_gain"]
        c_a, c_b = stiff_a * area**2, stiff_b * area_b**2
        g_a, g_b = area * stiff_a * k_v * np.sqrt(drop_a), area_b * stiff_b * k_v * np.sqrt(drop_b)
        sigma = c_a / (c_a + c_b)
        slope = 0.5 * k_v * (stiff_a / np.sqrt(drop_a) * sigma + stiff_b / np.sqrt(drop_b) * (1.0 - sigma))
        leak_a, leak_b = stiff_a * b["leakage"], stiff_b * b["leakage"]
        leak = (leak_a + leak_b * b["area_ratio"]) * sigma + (leak_b + leak_a / b["area_ratio"]) * (1.0 - sigma)
        return c_a + c_b, g_a + g_b, slope, leak

    own = {name: of.get(name, 1.0) * b[name] for name in (*law, "spring_stiffness", "spool_bandwidth")}
    c, g, slope, leak = chambers(own)
    eta = area / (own["dead_volume_a"] + area * x) * area * state["pressure_a_rate"]
    eta += area_b / (own["dead_volume_b"] + area_b * (b["stroke"] - x)) * area_b * state["pressure_b_rate"]
    c_law, g_law, slope_law, _ = chambers(law)
    (lowest, highest), c_1 = content["proportional_gain"], content["velocity_compensation"][0]
    k_p = rng.uniform(lowest, highest, count)
    a, omega, m, k = g / g_law, 2.0 * math.pi * own["spool_bandwidth"], b["moving_mass"], own["spring_stiffness"]
    cell, drift = 2.0 * math.pi * b["cell_bandwidth"], np.expm1(T * state["gain_drift"])
    rates = np.zeros((count, 8, 8))
    rates[:, 0, 0], rates[:, 0, 1] = -slope * np.abs(s) - leak, 1.0 + 0.5 * drift
    rates[:, 0, 5], rates[:, 0, 6], rates[:, 1, 2] = -eta, -c, 1.0
    rates[:, 2, 1], rates[:, 2, 2], rates[:, 2, 7] = -(omega**2), -2.0 * b["spool_damping"] * omega, omega**2
    rates[:, 3, 4], rates[:, 4, 3], rates[:, 4, 4] = 1.0, -(cell**2), -2.0 * b["cell_damping"] * cell
    rates[:, 4, 5], rates[:, 5, 6] = k * cell**2, 1.0
    rates[:, 6, 0], rates[:, 6, 5], rates[:, 6, 6] = 1.0 / m, -k / m, -b["viscous_friction"] / m
    unit = np.array([*content["scale"][:7], content["scale"][1]])
    moved, scale, n = expm(T * rates * unit / unit[:, None]), np.array(content["scale"]), len(content["scale"])
    feedback, ways = np.zeros((count, n)), n - 8
    feedback[:, 0], feedback[:, 3], feedback[:, 7] = a * slope_law * np.abs(nominal), -a * k_p, c_1 * a * c_law
    feedback *= scale / scale[1]
    currents = np.stack([feedback, *(np.tile(np.eye(n)[8 + way], (count, 1)) for way in range(ways))])
    loop, memory, pushed = np.zeros((count, n, n)), b["velocity_memory"], moved[:, :7, 7]
    loop[:, :7, :7] = moved[:, :7, :7]
    if ways:  # the newer current acts in the last part of the sample
        share = ((ways * T - of["dead_time"]) / T)[:, None, None]
        fresh = expm(share * T * rates * unit / unit[:, None])[:, :7, 7]
        loop[:, :7] += fresh[..., None] * currents[-2][:, None]
        pushed = pushed - fresh
    loop[:, :7] += pushed[..., None] * currents[-1][:, None]
    loop[:, 7] = (loop[:, 5] - np.eye(n)[5]) * (1.0 - memory) / T * scale[5] / scale[7]
    loop[:, 7, 7] += memory
    loop[:, 8:] = currents[:-1].transpose(1, 0, 2)
    loop[:, [1, 2, *range(8, n)]] *= (1.0 + drift)[:, None, None]
    return k_p, loop


def growth(content: dict[str, Any], count: int) -> FloatArray:
    """Growth of the worst direction in 1/s at points of the region, shape (count,): 0 or less holds."""
    k_p, loop = drawn_loops(content, count)
    gains, matrices = content["cells"][0]["gains"], np.array(content["cells"][0]["matrices"])
    metric = np.tensordot(np.stack([np.interp(k_p, gains, hat) for hat in np.eye(len(gains))], axis=1), matrices, 1)
    factor = np.linalg.cholesky(metric)
    half = np.linalg.solve(factor, loop.transpose(0, 2, 1) @ factor)
    largest = np.linalg.eigvalsh(half @ half.transpose(0, 2, 1))[:, -1]
    return (largest - math.exp(-2.0 * content["contraction_rate"] * T)) / T


@pytest.mark.parametrize("name", NAMES)
def test_a_part_of_the_statement_is_proved(name: str) -> None:
    assert verify(shortened(name)) == ""


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_the_whole_statement_is_proved(name: str) -> None:
    assert verify(content_of(name)) == ""


@pytest.mark.parametrize("name", NAMES)
def test_no_point_of_the_region_violates(name: str) -> None:
    assert growth(content_of(name), 50_000).max() <= 0.0


@pytest.mark.parametrize("dead_time", [0.0, 0.4e-3, 1.4e-3, 2.7e-3])
@pytest.mark.parametrize("side", [1, -1])
def test_the_points_of_the_region_are_enclosed_whatever_the_dead_time(dead_time: float, side: int) -> None:
    content = content_of("paper")
    content["tolerances"]["dead_time"] = [0.9 * dead_time, dead_time]
    content["scale"] += [content["scale"][1]] * math.ceil(1e3 * dead_time)
    most = min(map(abs, content["states"]["opening"]))  # on either side
    content["states"]["opening"] = [-most, most]
    n, enclosed = len(content["scale"]), sample(content, content["tolerances"], side, I(*content["proportional_gain"]))
    _, loops = drawn_loops(content, 2000, side)
    reach = (np.abs(enclosed.s[1:]).sum(axis=0) + enclosed.r)[:, :n]
    apart = np.abs(loops - enclosed.s[0, :, :n])
    assert (apart <= reach + 1e-12).all()
    assert (apart.max(axis=0)[0] > 0.01 * reach[0]).any(), "the set is of the size of what it encloses"


def test_half_of_lambda_is_accepted_and_a_metric_for_a_part_of_the_tolerances_refused() -> None:
    part = shortened(NAMES[0])
    part["contraction_rate"] *= 0.5
    assert verify(part) == ""
    part["tolerances"]["valve_gain"] = [1.0, 1.04]
    assert "tolerances" in verify(part)


@pytest.mark.parametrize("lie", ["bent metric", "wide tolerance"])
def test_what_a_point_violates_is_refused(lie: str) -> None:
    part = shortened(NAMES[0])
    (cell,) = part["cells"]
    if lie == "bent metric":
        for matrix in cell["matrices"]:
            matrix[3][3] *= 1.3
    else:
        part["tolerances"]["valve_gain"] = cell["tolerances"]["valve_gain"] = [1.0, 1.04]
    assert growth(part, 2000).max() > 0.0
    assert verify(part) != ""


def target(name: str, **changed: Any) -> RegionTarget:
    content = content_of(name)
    law = BoxConfig().of_bench(Bench.nominal()).compensated if name == "compensated" else None
    asked = {"gains": tuple(content["cells"][0]["gains"]), "gain_rate": content["gain_rate"]} | changed
    return RegionTarget(law=law, rate=content["contraction_rate"], force=content["facts"]["force"] / 300.0, **asked)


@pytest.mark.parametrize("name", NAMES)
def test_the_statement_is_of_the_shipped_bench(name: str) -> None:
    content = content_of(name)
    made, _ = unproved_statement(load_model(), Bench.nominal(), target(name))
    made = json.loads(json.dumps(made)) | {key: content[key] for key in ("tube", "cells", "facts", "assumed")}
    states = made.pop("states"), content.pop("states")
    assert made == content
    for state, (low, high) in states[0].items():
        np.testing.assert_allclose((low, high), states[1][state], rtol=1e-3)


@pytest.mark.study
def test_a_region_is_proved_anew() -> None:
    pytest.importorskip("clarabel")
    made = certify_region(load_model(), Bench.nominal(), target("compensated", gains=(350.0, 400.0), gain_rate=0.0))
    assert made is not None and verify(json.loads(json.dumps(made))) == ""
    assert made["tube"] < content_of("compensated")["tube"]
