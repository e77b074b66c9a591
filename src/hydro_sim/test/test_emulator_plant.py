# SPDX-License-Identifier: Apache-2.0
"""Oil, valve and supply of the truth plant against closed forms, many with the piston held by a huge mass."""

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
SUPPLY, GAIN = 16e6, 1.67e-4 / (0.05 * np.sqrt(3.5e6))
VOLUME_A, VOLUME_B = DEAD + AREA * REST, DEAD + RATIO * AREA * (STROKE - REST)


def truth(bench: dict[str, Any] | None = None, outside: dict[str, Any] | None = None, **effects: Any) -> TruthPlant:
    return TruthPlant(
        truth_from_mapping({"profile": "nominal", "bench": bench or {}, "effects": effects, "outside": outside or {}})
    )


def locked(**effects: Any) -> TruthPlant:
    plant = truth(**effects)
    plant.parameters["mass"] = 1e12
    return plant


def column(log: FloatArray, name: str) -> FloatArray:
    return log[:, TRUTH_FIELDS.index(name)]


def run(plant: TruthPlant, currents: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """After each sample: the measurement, shape (n, 8); it without noise; `TRUTH_FIELDS`, shape (n, 12)."""
    noisy, clean = np.empty((2, len(currents), len(PLANT_FIELDS)))
    log = np.empty((len(currents), len(TRUTH_FIELDS)))
    for k, current in enumerate(currents):
        noisy[k], clean[k] = plant.step(float(current)), plant.chain["clean"][0]
        truth_plant.copy_physical(plant.state, log[k])
    return noisy, clean, log


def held(plant: TruthPlant, current: float, seconds: float) -> FloatArray:
    return run(plant, np.full(round(seconds * 1000), current))[2]


def first_rate(plant: TruthPlant, current: float) -> tuple[float, float]:
    """Pressure of chamber a [Pa] after two milliseconds of the current, and its rate [Pa/s] about then."""
    before, pressure, after = column(held(plant, current, 3e-3), "pressure_a")
    return pressure, (after - before) / 2e-3


def test_nominal_truth_agrees_with_the_independent_analytic_plant(bench: Bench) -> None:
    """Two formulations of the same equations: what differs is discretisation and laminar orifices."""
    currents = 0.004 * np.sin(2 * np.pi * np.arange(1000) * 1e-3 * 2.0)
    plant = truth()
    other = AnalyticPlant(bench, noise=0.0)
    p, y = plant.parameters[0], plant.state["y"][0]
    _, _, _, _, y[0], y[1], _, _ = other.reset(0)  # the same pressures to start from
    y[0], y[1] = dynamics.content_of(p, y[0], VOLUME_A), dynamics.content_of(p, y[1], VOLUME_B)
    _, clean, _ = run(plant, currents)
    expected = np.array([other.step(float(current)) for current in currents])
    scale = np.ptp(expected, axis=0)
    assert np.max(np.abs(clean - expected) / scale, axis=0) == pytest.approx(np.zeros(8), abs=1e-4)


@pytest.mark.parametrize("current", [0.01, -0.02])
def test_pressure_of_a_locked_chamber_rises_by_the_orifice_law(current: float) -> None:
    pressure, rate = first_rate(locked(), current)
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
    plain = first_rate(locked(), 0.001)[1]
    assert first_rate(locked(valve_deadband=band), 0.003)[1] == pytest.approx(plain, rel=1e-6)
    plain = first_rate(locked(), -0.001)[1]
    assert first_rate(locked(valve_deadband=band), -0.004)[1] == pytest.approx(plain, rel=1e-6)


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
        plain, changed = (first_rate(locked(**chosen), current)[1] for chosen in ({}, effects))
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


STIFFNESS, MASS = 2e4, 1.2
OIL = BETA * AREA**2 * (1 / (DEAD + AREA * REST) + RATIO**2 / (DEAD + RATIO * AREA * (STROKE - REST)))  # N/m


def displaced(plant: TruthPlant, distance: float) -> None:
    """Move the resting piston by hand, quickly: the oil stays where it is."""
    plant.state["y"][0][2] += distance


@pytest.mark.parametrize("added", [0.0, 0.6])
def test_mass_swings_on_oil_at_the_closed_form_frequency(added: float) -> None:
    plant = truth({"viscous_friction": 0.0}, moving_mass={"mass": added})
    displaced(plant, 1e-5)
    position = column(held(plant, 0.0, 0.4), "piston_position") - REST
    crossings = np.flatnonzero(np.diff(np.sign(position)))
    exact = crossings - position[crossings] / (position[crossings + 1] - position[crossings])
    frequency = 0.5 / (1e-3 * np.mean(np.diff(exact)))
    assert frequency == pytest.approx(np.sqrt((OIL + STIFFNESS) / (MASS + added)) / (2 * np.pi), rel=2e-3)


def test_viscous_friction_damps_a_swing_at_the_closed_form_rate() -> None:
    plant = truth(friction_viscous={"coefficient": -40.0})
    displaced(plant, 1e-5)
    log = held(plant, 0.0, 0.3)
    kinetic = 0.5 * MASS * column(log, "piston_velocity") ** 2
    energy = kinetic + 0.5 * (OIL + STIFFNESS) * (column(log, "piston_position") - REST) ** 2
    assert energy[200:300].mean() / energy[100:200].mean() == pytest.approx(np.exp(-20.0 / MASS * 0.1), rel=0.02)


@pytest.mark.parametrize("form", ["static", "smooth", "lugre"])
@pytest.mark.parametrize(("sign", "force"), [(1.0, 15.0), (-1.0, 9.0)])
def test_sliding_friction_is_coulomb_in_each_direction(form: str, sign: float, force: float) -> None:
    coulomb = {"force_positive": 15.0, "force_negative": 9.0, "form": form}
    log = held(truth(friction_coulomb=coulomb), sign * 0.003, 0.15)
    dry = column(log, "friction_force") - 60.0 * column(log, "piston_velocity")
    assert np.abs(column(log, "piston_velocity")[-30:]).min() > 0.02
    assert dry[-30:] == pytest.approx(np.full(30, sign * force), rel=2e-3)


@pytest.mark.parametrize(("push", "breaks_away"), [(13.0, False), (17.0, True), (-7.0, False), (-11.0, True)])
def test_static_friction_holds_by_the_level_of_the_direction_that_it_opposes(push: float, breaks_away: bool) -> None:
    coulomb = {"force_positive": 15.0, "force_negative": 9.0}
    plant = truth(friction_coulomb=coulomb, force_offset={"force": push})
    travel = np.abs(column(held(plant, 0.0, 0.2), "piston_position") - REST).max()
    assert (travel > 1e-6) == breaks_away


def test_lugre_deflects_before_sliding_by_its_stiffness() -> None:
    """Below breakaway bristles, oil and spring share the push; above it the bristles let go."""
    stiffness = 8e5
    effects = {"friction_coulomb": {"force": 12.0, "form": "lugre"}, "friction_presliding": {"stiffness": stiffness}}
    position = column(held(truth(force_offset={"force": 0.1}, **effects), 0.0, 0.3), "piston_position")[-1] - REST
    assert position == pytest.approx(0.1 / (stiffness + OIL + STIFFNESS), rel=0.03)
    sliding = held(truth(force_offset={"force": 60.0}, **effects), 0.0, 0.3)
    assert column(sliding, "piston_position")[-1] - REST > 30.0 / (OIL + STIFFNESS)


@pytest.mark.parametrize("form", ["static", "lugre"])
@pytest.mark.parametrize("current", [1e-4, 1e-3])
def test_moving_slowly_takes_more_force_than_moving_fast(form: str, current: float) -> None:
    effects = {
        "friction_coulomb": {"force": 12.0, "form": form},
        "friction_stribeck": {"breakaway_force": 8.0, "velocity": 0.005},
    }
    plant = truth({"viscous_friction": 2000.0}, **effects)  # so that slow sliding is steady, not stick-slip
    log = held(plant, current, 0.6)[-50:]
    velocity = column(log, "piston_velocity")
    dry = column(log, "friction_force") - 2000.0 * velocity
    assert dry.mean() == pytest.approx(np.mean(12.0 + 8.0 * np.exp(-((velocity / 0.005) ** 2))), rel=0.01)
    assert (dry.mean() > 15.0) == (current < 5e-4)


@pytest.mark.parametrize(
    ("effects", "position", "expected"),
    [
        ({}, 0.05, 200.0),
        ({"spring_stiffness": {"ratio": 1.2}}, 0.05, 240.0),
        ({"spring_rest": {"position": 0.045}}, 0.05, 100.0),
        ({"spring_hardening": {"coefficient": 5e7}}, 0.05, 250.0),
        ({"spring_hardening": {"coefficient": 5e7}}, 0.03, -250.0),
        ({"backlash": {"width": 2e-3}}, 0.0409, 0.0),
        ({"backlash": {"width": 2e-3}}, 0.042, 20.0),
        ({"backlash": {"width": 2e-3}}, 0.038, -20.0),
    ],
)
def test_load_force_over_position(effects: dict[str, Any], position: float, expected: float) -> None:
    p = truth(**effects).parameters[0]
    assert dynamics.load_force(p, position, REST, 0.0) == pytest.approx(expected, abs=1e-6)


def test_play_drags_the_springs_end_and_loses_its_width_at_each_reversal() -> None:
    p = truth(backlash={"width": 2e-3, "form": "play"}).parameters[0]
    end, forces = REST, []
    for position in (0.05, 0.0485, 0.047):
        end = dynamics.drag_spring_end(p, position, end)
        forces.append(dynamics.load_force(p, position, end, 0.0))
    assert forces == pytest.approx([180.0, 180.0, 160.0])


def test_bouc_wen_spring_saturates_and_loses_energy_round_a_cycle() -> None:
    plant = truth(outside={"spring_hysteresis": {"force": 40.0, "deflection": 1e-3}})
    log = run(plant, 0.002 * np.sin(2 * np.pi * 2.0 * np.arange(2000) * 1e-3))[2][1000:]
    extra = column(log, "load_force") - STIFFNESS * (column(log, "piston_position") - REST)
    assert np.abs(extra).max() == pytest.approx(40.0, rel=0.05)
    lost = np.sum(0.5 * (extra[1:] + extra[:-1]) * np.diff(column(log, "piston_position")))
    assert lost > 1e-2


@pytest.mark.parametrize(("form", "at_10_mm"), [("linear", 10.0), ("quadratic", 20.0)])
def test_cushion_pushes_back_beyond_its_position_towards_its_end(form: str, at_10_mm: float) -> None:
    cushions = [{"position": 0.05, "stiffness": 1e3, "form": form}, {"position": 0.03, "stiffness": 1e3, "form": form}]
    p = truth(end_cushion=cushions).parameters[0]
    assert dynamics.end_force(p, 0.06, 0.0) == pytest.approx(-at_10_mm)
    assert dynamics.end_force(p, 0.02, 0.0) == pytest.approx(at_10_mm)
    assert dynamics.end_force(p, 0.04, 0.0) == 0.0


def test_piston_stops_at_the_ends_of_its_stroke() -> None:
    for current in (0.05, -0.05):
        position = column(held(truth(), current, 0.5), "piston_position")
        assert position.min() > -1e-3
        assert position.max() < STROKE + 1e-3


MOVING = 0.003 * np.sin(2 * np.pi * 2.0 * np.arange(1500) * 1e-3)


def logs(
    sensors: dict[str, Any] | None = None, outside: dict[str, Any] | None = None, **effects: Any
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Measured, noise-free and physical columns of a moving bench with an ideal load cell, by field name."""
    config = {
        "profile": "nominal",
        "bench": {"load_cell_bandwidth": None},
        "sensors": sensors or {},
        "effects": effects,
        "outside": outside or {},
    }
    noisy, clean, log = run(TruthPlant(truth_from_mapping(config)), MOVING)
    return {name: (noisy[:, i], clean[:, i], log[:, i]) for i, name in enumerate(PLANT_FIELDS)}


@pytest.mark.parametrize("scale", [0.1, 1.0, 4.0])
def test_noise_has_the_stated_deviation(scale: float) -> None:
    columns = logs({"noise_scale": scale})
    for name, deviation in (("hydraulic_force", 0.6), ("load_force", 0.6), ("pressure_a", 6e3), ("pressure_b", 6e3)):
        noisy, clean, physical = columns[name]
        assert np.std(noisy - clean) == pytest.approx(scale * deviation, rel=0.08)
        assert clean == pytest.approx(physical, abs=1e-9 * np.abs(physical).max())


def test_encoder_counts_whole_micrometers_and_no_finer() -> None:
    noisy, clean, _ = logs()["piston_position"]
    assert noisy * 1e6 == pytest.approx(np.rint(noisy * 1e6), abs=1e-6)
    assert np.abs(noisy - clean).max() <= 0.5e-6 + 1e-12
    assert len(np.unique(noisy)) > 100


@pytest.mark.parametrize(
    ("effects", "name", "gain", "bias"),
    [
        ({"load_cell_gain": {"ratio": 1.05}}, "load_force", 1.05, 0.0),
        ({"load_cell_gain": {"ratio": 0.9, "cell": "hydraulic_force"}}, "hydraulic_force", 0.9, 0.0),
        ({"load_cell_bias": {"force": -7.0, "cell": "hydraulic_force"}}, "hydraulic_force", 1.0, -7.0),
        ({"pressure_sensor_bias": {"pressure": 2e5, "chamber": "b"}}, "pressure_b", 1.0, 2e5),
    ],
)
def test_gain_and_bias_touch_their_own_sensor_only(
    effects: dict[str, Any], name: str, gain: float, bias: float
) -> None:
    for other, (_, clean, physical) in logs(**effects).items():
        if not other.endswith(("_rate", "_velocity")):
            expected = gain * physical + bias if other == name else physical
            assert clean == pytest.approx(expected, abs=1e-9 * np.abs(physical).max())


@pytest.mark.parametrize("order", [1, 2])
def test_sensor_lag_is_the_low_pass_that_it_says(order: int) -> None:
    """Against scipy's exact response of the same filter to the physical force."""
    lag = {"bandwidth": 30.0, "order": order, "damping": 0.6}
    _, clean, physical = logs(sensor_lag=lag)["load_force"]
    w = 2 * np.pi * 30.0
    system = ([w], [1.0, w]) if order == 1 else ([w * w], [1.0, 1.2 * w, w * w])
    _, expected, _ = signal.lsim(system, physical, np.arange(len(physical)) * 1e-3)
    assert clean == pytest.approx(expected, abs=1e-3 * np.abs(physical).max())
    assert np.abs(clean - physical).max() > 0.02 * np.abs(physical).max()
