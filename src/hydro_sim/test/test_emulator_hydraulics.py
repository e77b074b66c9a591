# SPDX-License-Identifier: Apache-2.0
"""Oil, valve and supply of the truth plant against closed forms, many with the piston held by a huge mass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_sim.emulator.truth import dynamics
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS, TruthPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

BETA, AREA, RATIO, DEAD, STROKE, REST = 1.34e9, 2e-4, 0.609, 2e-4, 0.08, 0.04
SUPPLY, GAIN = 16e6, 1.67e-4 / (0.05 * np.sqrt(3.5e6))
VOLUME_A, VOLUME_B = DEAD + AREA * REST, DEAD + RATIO * AREA * (STROKE - REST)


def truth(outside: dict[str, Any] | None = None, **effects: Any) -> TruthPlant:
    return TruthPlant(truth_from_mapping({"profile": "nominal", "effects": effects, "outside": outside or {}}))


def locked(outside: dict[str, Any] | None = None, **effects: Any) -> TruthPlant:
    plant = truth(outside, **effects)
    plant.parameters["mass"] = 1e12
    return plant


def column(log: FloatArray, name: str) -> FloatArray:
    return log[:, TRUTH_FIELDS.index(name)]


def held(plant: TruthPlant, current: float, seconds: float) -> FloatArray:
    return plant.run(np.full(round(seconds * 1000), current))[2]


def first_rate(plant: TruthPlant, current: float, chamber: str, skip: int = 0) -> tuple[float, float]:
    """Pressure [Pa] in the middle of a millisecond, and its rate [Pa/s] over it, after `skip` ms of the current."""
    log = held(plant, current, 1e-3 * (skip + 3))
    before, after = column(log, f"pressure_{chamber}")[[skip, skip + 2]]
    return column(log, f"pressure_{chamber}")[skip + 1], (after - before) / 2e-3


def test_bench_at_rest_stays_at_rest() -> None:
    log = held(truth(), 0.0, 0.5)
    assert np.ptp(column(log, "pressure_a")) < 1e-3
    assert np.ptp(column(log, "piston_position")) < 1e-12


def test_nominal_truth_agrees_with_the_independent_analytic_plant(bench: Bench) -> None:
    """Two formulations of the same equations: what differs is discretisation and laminar orifices."""
    currents = 0.004 * np.sin(2 * np.pi * np.arange(1000) * 1e-3 * 2.0)
    plant = truth()
    other = AnalyticPlant(bench, noise=0.0)
    p, y = plant.parameters[0], plant.state["y"][0]
    _, _, _, _, y[0], y[1], _, _ = other.reset(0)  # the same pressures to start from
    y[0], y[1] = dynamics.content_of(p, y[0], VOLUME_A), dynamics.content_of(p, y[1], VOLUME_B)
    _, clean, _ = plant.run(currents)
    expected = np.array([other.step(float(current)) for current in currents])
    scale = np.ptp(expected, axis=0)
    assert np.max(np.abs(clean - expected) / scale, axis=0) == pytest.approx(np.zeros(8), abs=1e-4)


@pytest.mark.parametrize("current", [0.01, -0.02])
def test_pressure_of_a_locked_chamber_rises_by_the_orifice_law(current: float) -> None:
    pressure, rate = first_rate(locked(), current, "a")
    drop = SUPPLY - pressure if current > 0 else pressure
    assert rate == pytest.approx(BETA / VOLUME_A * GAIN * current * np.sqrt(drop), rel=1e-3)


def test_closed_chambers_keep_their_oil() -> None:
    plant = truth(outside={"load_hum": {"amplitude": 100.0, "frequency": 20.0}})
    before = plant.state["y"][0][:2].copy()
    held(plant, 0.0, 0.5)
    assert plant.state["y"][0][:2] == pytest.approx(before, rel=1e-14)


def test_internal_leak_equalises_at_the_closed_form_rate() -> None:
    leak = 1e-12
    log = held(locked(leakage_internal={"coefficient": leak}), 0.0, 0.2)
    drop = column(log, "pressure_a") - column(log, "pressure_b")
    rate = leak * BETA * (1 / VOLUME_A + 1 / VOLUME_B)
    times = np.arange(len(drop)) * 1e-3
    assert drop == pytest.approx(drop[0] * np.exp(-rate * times), rel=1e-3)


@pytest.mark.parametrize(("chamber", "volume"), [("a", VOLUME_A), ("b", VOLUME_B)])
def test_external_leak_empties_its_chamber_alone(chamber: str, volume: float) -> None:
    leak = 1e-12
    log = held(locked(leakage_external={"coefficient": leak, "chamber": chamber}), 0.0, 0.2)
    pressure = column(log, f"pressure_{chamber}")
    assert pressure == pytest.approx(pressure[0] * np.exp(-leak * BETA / volume * np.arange(200) * 1e-3), rel=1e-3)
    assert np.ptp(column(log, "pressure_b" if chamber == "a" else "pressure_a")) < 2e4  # the piston gives a little


def test_deadband_lets_nothing_through_inside_and_the_rest_outside() -> None:
    band = {"half_width": 0.002, "half_width_negative": 0.003}
    assert np.ptp(column(held(locked(valve_deadband=band), 0.0019, 0.1), "pressure_a")) < 1e-3
    assert np.ptp(column(held(locked(valve_deadband=band), -0.0029, 0.1), "pressure_a")) < 1e-3
    plain = first_rate(locked(), 0.001, "a")[1]
    assert first_rate(locked(valve_deadband=band), 0.003, "a")[1] == pytest.approx(plain, rel=1e-6)
    plain = first_rate(locked(), -0.001, "a")[1]
    assert first_rate(locked(valve_deadband=band), -0.004, "a")[1] == pytest.approx(plain, rel=1e-6)


def test_spool_of_first_order_reaches_63_percent_after_its_time_constant() -> None:
    plant = truth(valve_lag={"bandwidth": 1000 / (2 * np.pi * 8), "order": 1})
    spool = column(held(plant, 0.01, 0.03), "spool")
    assert spool[7] == pytest.approx(0.01 * (1 - np.exp(-1)), rel=1e-4)  # 8 ms later


def test_spool_of_second_order_overshoots_by_its_damping() -> None:
    spool = column(held(truth(valve_lag={"bandwidth": 20.0, "damping": 0.4}), 0.01, 0.2), "spool")
    assert spool.max() / 0.01 - 1 == pytest.approx(np.exp(-np.pi * 0.4 / np.sqrt(1 - 0.16)), rel=1e-2)


@pytest.mark.parametrize("order", [1, 2])
def test_spool_never_exceeds_its_rate_limit(order: int) -> None:
    spool = column(held(truth(valve_lag={"bandwidth": 200.0, "rate_limit": 2.0, "order": order}), 0.04, 0.03), "spool")
    assert np.max(np.diff(spool)) == pytest.approx(2e-3, rel=1e-6)


def test_transport_delay_shifts_the_command_by_exactly_its_time() -> None:
    """A delay of 2.4 ms: in the third millisecond the command acts for 0.6 ms."""
    reference = column(held(locked(), 0.01, 0.01), "pressure_a")
    delayed = column(held(locked(transport_delay={"time": 2.4e-3}), 0.01, 0.01), "pressure_a")
    assert np.ptp(delayed[:2]) < 1e-3
    assert delayed[2] - delayed[1] == pytest.approx(0.6 * (reference[0] - delayed[1]), rel=1e-2)
    whole = column(held(locked(transport_delay={"time": 3e-3}), 0.01, 0.01), "pressure_a")
    assert whole[3:] == pytest.approx(reference[:-3], rel=1e-12)


@pytest.mark.parametrize(
    ("effects", "positive", "negative"),
    [({"valve_gain": {"ratio": 0.8}}, 0.8, 0.8), ({"valve_gain_asymmetry": {"ratio": 1.3}}, 1.0, 1.3)],
)
def test_gain_and_asymmetry_scale_the_flow(effects: dict[str, Any], positive: float, negative: float) -> None:
    for current, ratio in ((0.002, positive), (-0.002, negative)):
        plain, changed = (first_rate(locked(**chosen), current, "a")[1] for chosen in ({}, effects))
        assert changed / plain == pytest.approx(ratio, rel=1e-2)


@pytest.mark.parametrize("form", ["bell", "hyperbolic"])
def test_null_leak_flows_through_both_edges_of_both_chambers(form: str) -> None:
    plant = locked(valve_null_leakage={"coefficient": 2e-9, "width": 1e-3, "form": form})
    log = held(plant, 0.0, 1.0)
    a, b, draw = (column(log, name)[-1] for name in ("pressure_a", "pressure_b", "valve_draw"))
    assert (a, b) == pytest.approx((SUPPLY / 2, SUPPLY / 2), rel=0.02)  # both chambers settle half-way
    assert draw == pytest.approx(2e-9 * (np.sqrt(SUPPLY - a) + np.sqrt(SUPPLY - b)), rel=1e-3)
    at_width = dynamics.null_leak(plant.parameters[0], 1e-3) / 2e-9
    assert at_width == pytest.approx(np.exp(-1) if form == "bell" else 0.5)


def test_supply_droops_by_resistance_times_flow() -> None:
    resistance = 2e10
    effects = {
        "supply_droop": {"resistance": resistance, "time_constant": 0.01},
        "valve_null_leakage": {"coefficient": 1e-8, "width": 0.01},
    }
    log = held(locked(**effects), 0.0, 0.5)
    draw, supply = column(log, "valve_draw")[-1], column(log, "supply_pressure")[-1]
    assert supply == pytest.approx(SUPPLY - resistance * draw, rel=1e-4)
    assert SUPPLY - supply > 1e5


@pytest.mark.parametrize(("form", "exponent"), [("adiabatic", 1.4), ("isothermal", 1.0)])
def test_entrained_air_softens_oil_by_the_textbook_formula(form: str, exponent: float) -> None:
    """1/K v = (1-phi) e^(-p/beta)/beta + phi/(n (p + p_0)) (p_0/(p + p_0))^(1/n), from volumes alone."""
    phi, p_0 = 0.01, 101325.0
    p = truth(entrained_air={"volume_fraction": phi, "form": form}).parameters[0]
    for pressure in (0.2e6, 1e6, 8e6):
        content = dynamics.content_of(p, pressure, 1e-4)
        softer = dynamics.pressure_of(p, content, 1e-4 * (1 - 1e-7), pressure)
        modulus = (softer - pressure) / 1e-7
        air = phi * (p_0 / (p_0 + pressure)) ** (1 / exponent)
        liquid = (1 - phi) * np.exp(-pressure / BETA)
        expected = (liquid + air) / (liquid / BETA + air / (exponent * (p_0 + pressure)))
        assert modulus == pytest.approx(expected, rel=1e-4)
    assert modulus < 0.98 * BETA


def test_bulk_modulus_and_hose_compliance_set_the_stiffness() -> None:
    stiff = truth(bulk_modulus={"ratio": 0.7}).parameters[0]
    content = dynamics.content_of(stiff, 5e6, 1e-4)
    assert dynamics.pressure_of(stiff, content * (1 + 1e-6), 1e-4, 5e6) - 5e6 == pytest.approx(
        0.7 * BETA * 1e-6, rel=1e-3
    )
    hoses = truth(outside={"wall_flexibility": {"compliance": 5e-14}}).parameters[0]
    content = dynamics.content_of(hoses, 5e6, 1e-4)
    expected = 1e-6 * (1e-4 + 5e-14 * 5e6) / (1e-4 / BETA + 5e-14)  # what is pumped in squeezes oil and widens hoses
    assert dynamics.pressure_of(hoses, content * (1 + 1e-6), 1e-4, 5e6) - 5e6 == pytest.approx(expected, rel=1e-2)


def test_pressure_never_falls_below_the_vapor_pressure() -> None:
    for effects in ({}, {"entrained_air": {"volume_fraction": 0.02}}):
        p = truth(**effects).parameters[0]
        assert dynamics.pressure_of(p, 0.5e-4, 1e-4, 1e6) == pytest.approx(-96e3, abs=3e3)
