# SPDX-License-Identifier: Apache-2.0
"""Friction, load and energy of the truth plant against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_sim.emulator.truth import dynamics
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS, TruthPlant

BETA, AREA, RATIO, DEAD, STROKE, REST, STIFFNESS, MASS = 1.34e9, 2e-4, 0.609, 2e-4, 0.08, 0.04, 2e4, 1.2
OIL = BETA * AREA**2 * (1 / (DEAD + AREA * REST) + RATIO**2 / (DEAD + RATIO * AREA * (STROKE - REST)))  # N/m


def truth(bench: dict[str, Any] | None = None, outside: dict[str, Any] | None = None, **effects: Any) -> TruthPlant:
    return TruthPlant(
        truth_from_mapping({"profile": "nominal", "bench": bench or {}, "effects": effects, "outside": outside or {}})
    )


def column(log: FloatArray, name: str) -> FloatArray:
    return log[:, TRUTH_FIELDS.index(name)]


def held(plant: TruthPlant, current: float, seconds: float) -> FloatArray:
    return plant.run(np.full(round(seconds * 1000), current))[2]


def displaced(plant: TruthPlant, distance: float) -> None:
    """Move the resting piston by hand, quickly: the oil stays where it is."""
    plant.state["y"][0][2] += distance


def swing_energy(log: FloatArray) -> FloatArray:
    kinetic = 0.5 * MASS * column(log, "piston_velocity") ** 2
    return kinetic + 0.5 * (OIL + STIFFNESS) * (column(log, "piston_position") - REST) ** 2


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
    energy = swing_energy(log)
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


def test_friction_takes_energy_out_at_every_instant() -> None:
    plant = truth(friction_coulomb={"force": 12.0, "form": "static"}, outside={"friction_rib": {"force": 20.0}})
    log = plant.run(0.003 * np.sin(2 * np.pi * 2.0 * np.arange(1000) * 1e-3))[2]
    power = column(log, "friction_force") * column(log, "piston_velocity")
    assert power.min() > -1e-6


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
        end = dynamics.dragged(p, position, end)
        forces.append(dynamics.load_force(p, position, end, 0.0))
    assert forces == pytest.approx([180.0, 180.0, 160.0])


def test_bouc_wen_spring_saturates_and_loses_energy_round_a_cycle() -> None:
    plant = truth(outside={"spring_hysteresis": {"force": 40.0, "deflection": 1e-3}})
    log = plant.run(0.002 * np.sin(2 * np.pi * 2.0 * np.arange(2000) * 1e-3))[2][1000:]
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
