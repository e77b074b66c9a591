# SPDX-License-Identifier: Apache-2.0
"""Certified region: the shipped statements are proved twice, points of the region agree, and lies are refused."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.verify_region import I, sample, verify
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.region.certified_region import CertifiedRegion
from hydro_filter.region.enclosure import enclose_closed_loop
from hydro_filter.region.interval import AffineSet, Interval
from hydro_filter.region.proof import interpolate_metric, prove_cell

T = SAMPLE_PERIOD
NAMES = ("default_metric.region.json", "default_metric.compensated.region.json")


def content_of(name: str) -> dict[str, Any]:
    return json.loads((resources.files("hydro_filter") / "data" / name).read_text(encoding="utf-8"))


def shortened(name: str) -> dict[str, Any]:
    """The statement of the last two gains alone: a proof of a part, in a part of the time."""
    part = content_of(name)
    for cell in part["cells"]:
        cell["gains"], cell["matrices"] = cell["gains"][-2:], cell["matrices"][-2:]
        part["proportional_gain"] = cell["gains"]
    return part


def drawn(content: dict[str, Any], count: int) -> FloatArray:
    """Growth of the worst direction in 1/s at points of the region, shape (count,): 0 or less holds.

    F + G K is the exponential of the rates that the bench's equations have at the point, without intervals.
    """
    rng, b, law = np.random.default_rng(0), content["bench"], content["believed"]
    state = {name: rng.uniform(low, high, count) for name, (low, high) in content["states"].items()}
    of = {name: rng.uniform(low, high, count) for name, (low, high) in content["tolerances"].items()}
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
    moved = expm(T * rates * unit / unit[:, None])
    feedback = np.zeros((count, 8))
    feedback[:, 0], feedback[:, 3], feedback[:, 7] = a * slope_law * np.abs(nominal), -a * k_p, c_1 * a * c_law
    sample, memory = np.zeros((count, 8, 8)), b["velocity_memory"]
    sample[:, :7, :7] = moved[:, :7, :7]
    sample[:, :7] += moved[:, :7, 7, None] * (feedback * content["scale"] / content["scale"][1])[:, None, :]
    sample[:, 7] = (sample[:, 5] - np.eye(8)[5]) * (1.0 - memory) / T * content["scale"][5] / content["scale"][7]
    sample[:, 7, 7] += memory
    sample[:, 1:3] *= (1.0 + drift)[:, None, None]
    gains, matrices = content["cells"][0]["gains"], CertifiedRegion.from_mapping(content).cells[0].matrices
    metric = np.tensordot(np.stack([np.interp(k_p, gains, hat) for hat in np.eye(len(gains))], axis=1), matrices, 1)
    factor = np.linalg.cholesky(metric)
    half = np.linalg.solve(factor, sample.transpose(0, 2, 1) @ factor)
    largest = np.linalg.eigvalsh(half @ half.transpose(0, 2, 1))[:, -1]
    return (largest - math.exp(-2.0 * content["contraction_rate"] * T)) / T


@pytest.mark.parametrize("name", NAMES)
def test_a_part_of_the_shipped_statement_is_proved_by_both(name: str) -> None:
    part = shortened(name)
    assert verify(part) == ""
    statement = CertifiedRegion.from_mapping(part)
    assert prove_cell(statement, statement.cells[0], subdivisions=6) > 0.0


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_statement_is_proved(name: str) -> None:
    assert verify(content_of(name)) == ""


@pytest.mark.parametrize("name", NAMES)
def test_no_point_of_the_region_violates(name: str) -> None:
    assert drawn(content_of(name), 50_000).max() <= 0.0


@pytest.mark.parametrize("dead_time", [0.0, 0.4e-3, 1.4e-3, 2.7e-3])
def test_both_enclose_the_same_loop_whatever_the_dead_time(dead_time: float) -> None:
    content = content_of(NAMES[0])
    content["tolerances"]["dead_time"] = [0.9 * dead_time, dead_time]
    content["scale"] += [content["scale"][1]] * math.ceil(1e3 * dead_time)
    region, count = CertifiedRegion.from_mapping(content), len(content["scale"])
    theirs = sample(content, content["tolerances"], 1, I(20.0, 21.0))
    ours = enclose_closed_loop(region, region.tolerances, 1, Interval(20.0, 21.0))
    np.testing.assert_allclose(ours.center[:, :count], theirs.s[0, :, :count], atol=1e-6)
    np.testing.assert_allclose(ours.slopes, theirs.s[1:], atol=1e-6)


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
    assert drawn(part, 2000).max() > 0.0
    assert verify(part) != ""


def test_intervals_and_affine_products_enclose_and_refuse_zero() -> None:
    third = 1.0 / Interval(3.0, 3.0)
    assert third.low < 1.0 / 3.0 < third.high
    assert (Interval(-1.0, 2.0) * Interval(-3.0, 1.0)).low <= -6.0
    with pytest.raises(ValueError, match="zero"):
        Interval(1.0, 1.0) / Interval(-1.0, 1.0)
    rng = np.random.default_rng(0)
    sets = [
        AffineSet(rng.normal(size=(4, 4)), 0.1 * rng.normal(size=(3, 4, 4)), 0.01 * rng.random((4, 4)))
        for _ in range(2)
    ]
    product = sets[0] @ sets[1]
    for _ in range(200):
        signs = rng.uniform(-1.0, 1.0, 3)
        one, other = (
            each.center + np.tensordot(signs, each.slopes, 1) + each.radius * rng.uniform(-1.0, 1.0, (4, 4))
            for each in sets
        )
        apart = np.abs(one @ other - product.center - np.tensordot(signs, product.slopes, 1))
        assert (apart <= product.radius).all()


def test_the_metric_between_gains_is_a_line() -> None:
    cell = CertifiedRegion.from_mapping(content_of(NAMES[0])).cells[0]
    middle = 0.5 * (cell.gains[0] + cell.gains[1])
    assert np.allclose(interpolate_metric(cell, middle), 0.5 * (cell.matrices[0] + cell.matrices[1]))
