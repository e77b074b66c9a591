# SPDX-License-Identifier: Apache-2.0
"""Oil, valve, mechanics and sensors of the truth plant against closed forms, many with the piston held."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal

from hydro_core.signals import PLANT_FIELDS, FloatArray
from hydro_sim.emulator.truth import dynamics
from hydro_sim.emulator.truth import plant as truth_plant
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS, TruthPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

BETA, AREA, RATIO, DEAD, STROKE, REST = 1.34e9, 2e-4, 0.609, 2e-4, 0.08, 0.04
SUPPLY, GAIN, STIFFNESS, MASS = 16e6, 1.67e-4 / (0.05 * np.sqrt(3.5e6)), 2e4, 1.2
VOLUME_A, VOLUME_B = DEAD + AREA * REST, DEAD + RATIO * AREA * (STROKE - REST)
OIL = BETA * AREA**2 * (1 / VOLUME_A + RATIO**2 / VOLUME_B)  # N/m
TIME = 1e-3 * np.arange(2000)
Log = dict[str, FloatArray]


def truth(
    bench: dict[str, Any] | None = None, outside: dict[str, Any] | None = None, sensors: dict[str, Any] | None = None,
    **effects: Any,
) -> TruthPlant:  # fmt: skip
    parts = {"bench": bench or {}, "effects": effects, "outside": outside or {}, "sensors": sensors or {}}
    return TruthPlant(truth_from_mapping({"profile": "nominal", **parts}))


def locked(**effects: Any) -> TruthPlant:
    """Its piston is held by a huge mass."""
    plant = truth(**effects)
    plant.parameters["mass"] = 1e12
    return plant


def run(plant: TruthPlant, currents: FloatArray) -> tuple[FloatArray, FloatArray, Log]:
    """After each sample: the measurement, shape (n, 8); it without noise; `TRUTH_FIELDS` by name."""
    noisy, clean = np.empty((2, len(currents), len(PLANT_FIELDS)))
    log = np.empty((len(currents), len(TRUTH_FIELDS)))
    for k, current in enumerate(currents):
        noisy[k], clean[k] = plant.step(float(current)), plant.chain["clean"][0]
        truth_plant.copy_physical(plant.state, log[k])
    return noisy, clean, dict(zip(TRUTH_FIELDS, log.T, strict=True))


def held(plant: TruthPlant, current: float, seconds: float) -> Log:
    return run(plant, np.full(round(seconds * 1000), current))[2]


def first_rate(plant: TruthPlant, current: float) -> tuple[float, float]:
    """Pressure of chamber a [Pa] after two milliseconds of the current, and its rate [Pa/s] about then."""
    before, pressure, after = held(plant, current, 3e-3)["pressure_a"]
    return pressure, (after - before) / 2e-3


def low_pass(lag: dict[str, float]) -> tuple[list[float], list[float]]:
    w = 2 * np.pi * lag["bandwidth"]
    return ([w], [1.0, w]) if lag["order"] == 1 else ([w * w], [1.0, 2.0 * lag["damping"] * w, w * w])


def test_nominal_truth_agrees_with_the_independent_analytic_plant(bench: Bench) -> None:
    """Two formulations of the same equations: what differs is discretisation and laminar orifices."""
    currents = 0.004 * np.sin(2 * np.pi * 2.0 * TIME[:1000])
    plant, other = truth(), AnalyticPlant(bench, noise=0.0)
    p, y = plant.parameters[0], plant.state["y"][0]
    pressure_a, pressure_b = other.reset(0)[4:6]  # the same to start from
    y[:2] = dynamics.content_of(p, pressure_a, VOLUME_A), dynamics.content_of(p, pressure_b, VOLUME_B)
    _, clean, _ = run(plant, currents)
    expected = np.array([other.step(float(current)) for current in currents])
    scale = np.ptp(expected, axis=0)
    assert np.max(np.abs(clean - expected) / scale, axis=0) == pytest.approx(np.zeros(8), abs=1e-4)


def test_closed_chambers_keep_their_oil() -> None:
    plant = truth(outside={"load_hum": {"amplitude": 100.0, "frequency": 20.0}})
    before = plant.state["y"][0][:2].copy()
    held(plant, 0.0, 0.5)
    assert plant.state["y"][0][:2] == pytest.approx(before, rel=1e-14)


@pytest.mark.parametrize("order", [1, 2])
def test_spool_is_the_low_pass_that_it_says_and_never_exceeds_its_rate_limit(order: int) -> None:
    lag = {"bandwidth": 20.0, "damping": 0.4, "order": order}
    expected = 0.01 * signal.step(low_pass(lag), T=TIME[:201])[1][1:]
    assert held(truth(valve_lag=lag), 0.01, 0.2)["spool"] == pytest.approx(expected, abs=6e-7)
    spool = held(truth(valve_lag={"bandwidth": 200.0, "rate_limit": 2.0, "order": order}), 0.04, 0.03)["spool"]
    assert np.max(np.diff(spool)) == pytest.approx(2e-3, rel=1e-6)


@pytest.mark.parametrize(
    ("effects", "positive", "negative"),
    [({"valve_gain": {"ratio": 0.8}}, 0.8, 0.8), ({"valve_gain_asymmetry": {"ratio": 1.3}}, 1.0, 1.3)],
)
def test_gain_and_asymmetry_scale_the_flow(effects: dict[str, Any], positive: float, negative: float) -> None:
    for current, ratio in ((0.002, positive), (-0.002, negative)):
        plain, changed = (first_rate(locked(**chosen), current)[1] for chosen in ({}, effects))
        assert changed / plain == pytest.approx(ratio, rel=1e-2)


@pytest.mark.parametrize(("form", "at_width"), [("bell", np.exp(-1)), ("hyperbolic", 0.5)])
def test_null_leak_flows_through_both_edges_of_both_chambers(form: str, at_width: float) -> None:
    plant = locked(valve_null_leakage={"coefficient": 2e-9, "width": 1e-3, "form": form})
    log = held(plant, 0.0, 1.0)
    a, b, draw = (log[name][-1] for name in ("pressure_a", "pressure_b", "valve_draw"))
    assert (a, b) == pytest.approx((SUPPLY / 2, SUPPLY / 2), rel=0.02)  # both chambers settle half-way
    assert draw == pytest.approx(2e-9 * (np.sqrt(SUPPLY - a) + np.sqrt(SUPPLY - b)), rel=1e-3)
    assert dynamics.null_leak(plant.parameters[0], 1e-3) / 2e-9 == pytest.approx(at_width)


def modulus(pressure: float, outside: dict[str, Any] | None = None, **effects: Any) -> float:
    """Rise of a pressure [Pa] by the share by which a chamber of 0.1 l shrinks."""
    p = truth(outside=outside, **effects).parameters[0]
    content = dynamics.content_of(p, pressure, 1e-4)
    return float(dynamics.pressure_of(p, content, 1e-4 * (1 - 1e-7), pressure) - pressure) / 1e-7


@pytest.mark.parametrize("pressure", [0.2e6, 1e6, 8e6])
def test_oil_is_as_stiff_as_the_textbook_says(pressure: float) -> None:
    """By its modulus; beside hoses, which widen; and with air: from volumes alone,
    1/K v = (1-phi) e^(-p/beta)/beta + phi/(n (p + p_0)) (p_0/(p + p_0))^(1/n).
    """
    phi, p_0, compliance = 0.01, 101325.0, 5e-14
    assert modulus(pressure, bulk_modulus={"ratio": 0.7}) == pytest.approx(0.7 * BETA, rel=1e-4)
    widened = compliance + (1e-4 + compliance * pressure) / BETA
    hoses = {"wall_flexibility": {"compliance": compliance}}
    assert modulus(pressure, hoses) == pytest.approx(1e-4 / widened, rel=1e-4)
    for form, exponent in (("adiabatic", 1.4), ("isothermal", 1.0)):
        air = phi * (p_0 / (p_0 + pressure)) ** (1 / exponent)
        liquid = (1 - phi) * np.exp(-pressure / BETA)
        expected = (liquid + air) / (liquid / BETA + air / (exponent * (p_0 + pressure)))
        found = modulus(pressure, entrained_air={"volume_fraction": phi, "form": form})
        assert found == pytest.approx(expected, rel=1e-4) and found < 0.98 * BETA


@pytest.mark.parametrize("effects", [{}, {"entrained_air": {"volume_fraction": 0.02}}])
def test_pressure_never_falls_below_the_vapor_pressure(effects: dict[str, Any]) -> None:
    p = truth(**effects).parameters[0]
    assert dynamics.pressure_of(p, 0.5e-4, 1e-4, 1e6) == pytest.approx(-96e3, abs=3e3)


UNEVEN = {"force_positive": 15.0, "force_negative": 9.0}


@pytest.mark.parametrize("form", ["static", "smooth", "lugre"])
@pytest.mark.parametrize(("sign", "force"), [(1.0, 15.0), (-1.0, 9.0)])
def test_sliding_friction_is_coulomb_in_each_direction(form: str, sign: float, force: float) -> None:
    log = held(truth(friction_coulomb={**UNEVEN, "form": form}), sign * 0.003, 0.15)
    velocity = log["piston_velocity"][-30:]
    assert np.abs(velocity).min() > 0.02
    assert log["friction_force"][-30:] - 60.0 * velocity == pytest.approx(np.full(30, sign * force), rel=2e-3)


@pytest.mark.parametrize(("push", "breaks_away"), [(13.0, False), (17.0, True), (-7.0, False), (-11.0, True)])
def test_static_friction_holds_by_the_level_of_the_direction_that_it_opposes(push: float, breaks_away: bool) -> None:
    log = held(truth(friction_coulomb=UNEVEN, force_offset={"force": push}), 0.0, 0.2)
    assert (np.abs(log["piston_position"] - REST).max() > 1e-6) == breaks_away


def test_lugre_deflects_before_sliding_by_its_stiffness() -> None:
    """Below breakaway bristles, oil and spring share the push; above it the bristles let go."""
    effects = {"friction_coulomb": {"force": 12.0, "form": "lugre"}, "friction_presliding": {"stiffness": 8e5}}
    bent, slid = (
        held(truth(force_offset={"force": push}, **effects), 0.0, 0.3)["piston_position"][-1] - REST
        for push in (0.1, 60.0)
    )
    assert bent == pytest.approx(0.1 / (8e5 + OIL + STIFFNESS), rel=0.03)
    assert slid > 30.0 / (OIL + STIFFNESS)


@pytest.mark.parametrize("form", ["static", "lugre"])
@pytest.mark.parametrize("current", [1e-4, 1e-3])
def test_moving_slowly_takes_more_force_than_moving_fast(form: str, current: float) -> None:
    rise = {"breakaway_force": 8.0, "velocity": 0.005}
    friction = {"friction_coulomb": {"force": 12.0, "form": form}, "friction_stribeck": rise}
    log = held(truth({"viscous_friction": 2000.0}, **friction), current, 0.6)  # so that slow sliding is steady
    velocity = log["piston_velocity"][-50:]
    dry = np.mean(log["friction_force"][-50:] - 2000.0 * velocity)
    assert dry == pytest.approx(np.mean(12.0 + 8.0 * np.exp(-((velocity / 0.005) ** 2))), rel=0.01)
    assert (dry > 15.0) == (current < 5e-4)


def test_bouc_wen_spring_saturates_and_loses_energy_round_a_cycle() -> None:
    plant = truth(outside={"spring_hysteresis": {"force": 40.0, "deflection": 1e-3}})
    log = run(plant, 0.002 * np.sin(2 * np.pi * 2.0 * TIME))[2]
    position = log["piston_position"][1000:]
    extra = log["load_force"][1000:] - STIFFNESS * (position - REST)
    assert np.abs(extra).max() == pytest.approx(40.0, rel=0.05)
    assert np.sum(0.5 * (extra[1:] + extra[:-1]) * np.diff(position)) > 1e-2


@pytest.mark.parametrize(("form", "at_10_mm"), [("linear", 10.0), ("quadratic", 20.0)])
def test_cushion_pushes_back_beyond_its_position_towards_its_end(form: str, at_10_mm: float) -> None:
    p = truth(end_cushion=[{"position": at, "stiffness": 1e3, "form": form} for at in (0.05, 0.03)]).parameters[0]
    forces = [dynamics.end_force(p, position, 0.0) for position in (0.06, 0.04, 0.02)]
    assert forces == pytest.approx([-at_10_mm, 0.0, at_10_mm])


@pytest.mark.parametrize("current", [0.05, -0.05])
def test_piston_stops_at_the_ends_of_its_stroke(current: float) -> None:
    position = held(truth(), current, 0.5)["piston_position"]
    assert position.min() > -1e-3 and position.max() < STROKE + 1e-3


def readings(**parts: Any) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Measured, noise-free and physical columns of a moving bench with an ideal load cell, by field name."""
    moving = 0.003 * np.sin(2 * np.pi * 2.0 * TIME[:1500])
    noisy, clean, log = run(truth({"load_cell_bandwidth": None}, **parts), moving)
    return {name: (noisy[:, i], clean[:, i], log[name]) for i, name in enumerate(PLANT_FIELDS)}


@pytest.mark.parametrize("scale", [0.1, 1.0, 4.0])
def test_noise_has_the_stated_deviation_and_the_encoder_counts_whole_micrometers(scale: float) -> None:
    columns = readings(sensors={"noise_scale": scale})
    for name, deviation in (("hydraulic_force", 0.6), ("load_force", 0.6), ("pressure_a", 6e3), ("pressure_b", 6e3)):
        noisy, clean, physical = columns[name]
        assert np.std(noisy - clean) == pytest.approx(scale * deviation, rel=0.08)
        assert clean == pytest.approx(physical, abs=1e-9 * np.abs(physical).max())
    if scale == 1.0:
        noisy, clean, _ = columns["piston_position"]
        assert noisy * 1e6 == pytest.approx(np.rint(noisy * 1e6), abs=1e-6)
        assert np.abs(noisy - clean).max() <= 0.5e-6 + 1e-12 and len(np.unique(noisy)) > 100
