# SPDX-License-Identifier: Apache-2.0
"""Effects of a corrected.yaml in the analytic plant, against closed forms and against the bench without them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray, ReferenceSignal, Waveform
from hydro_sim.model import equations, hydraulics, sensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import grown
from hydro_sim.model.effects.catalogue import CATALOGUE, kind_of
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Noise, Sensors
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


def effect(name: str, **parameters: float) -> dict[str, Any]:
    identifier, *options = name.split()
    return {"id": identifier, **dict(option.split("=") for option in options), "parameters": parameters}


def with_effects(bench: Bench, *effects: dict[str, Any]) -> Bench:
    return replace(bench, effects=effects)


def wave(samples: int = 600) -> FloatArray:
    time = SAMPLE_PERIOD * np.arange(samples)
    return np.asarray(4e-4 * np.sin(2 * np.pi * 3 * time) + 2e-4 * np.sin(2 * np.pi * 17 * time))


def test_a_bench_without_effects_moves_as_the_force_laws_equations_say(bench: Bench) -> None:
    """`hydraulics` is written for the box's force law: another writing, another compiler, the same numbers."""
    constants, settings = bench.constants(), Sensors().constants()
    y, noise, x = hydraulics.rest_state(constants[0]), Noise(4), np.zeros(8)
    last = np.zeros(1, CONDITIONING_DTYPE)

    def read() -> FloatArray:
        raw = np.array([equations.hydraulic_force(bench, y[0], y[1]), y[4], y[0], y[1], y[2]])
        sensors.sense(settings[0], noise.row(), raw)
        return raw

    plant = AnalyticPlant(bench, settings=replace(Sensors(), position_step=0.0))
    settings["position_step"] = 0.0  # rounding apart may fall on either side of a step
    first = plant.reset(4)
    sensors.restart(last[0], read(), x)
    np.testing.assert_allclose(first, x, rtol=1e-13)
    for current in wave(200):
        hydraulics.advance(constants[0], y, current, SAMPLE_PERIOD, hydraulics.SUBSTEPS)
        sensors.condition(settings[0], last[0], read(), x)
        np.testing.assert_allclose(plant.step(float(current)), x, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "parameters", "field", "value"),
    [
        ("friction_viscous", {"coefficient": 40.0}, "viscous_friction", 100.0),
        ("moving_mass", {"mass": 0.3}, "moving_mass", 1.5),
        ("spring_stiffness", {"ratio": 0.9}, "spring_stiffness", 18000.0),
        ("spring_rest", {"position": 0.035}, "spring_rest_position", 0.035),
        ("supply_pressure", {"ratio": 0.5}, "supply_pressure", 8e6),
        ("tank_pressure", {"pressure": 3e5}, "tank_pressure", 3e5),
        ("piston_area", {"ratio": 1.1}, "piston_area", 2.2e-4),
        ("area_ratio", {"ratio": 0.5}, "area_ratio", 0.3045),
        ("dead_volume chamber=b", {"ratio": 2.0}, "dead_volume_b", 4e-4),
        ("friction_viscous", {"coefficient": -100.0}, "viscous_friction", 0.0),
    ],
)
def test_wrong_numbers_are_put_right(
    name: str, parameters: dict[str, float], field: str, value: float, bench: Bench
) -> None:
    corrected = with_effects(bench, effect(name, **parameters)).constants()
    assert corrected.tobytes() == replace(bench, **{field: pytest.approx(value).expected}).constants().tobytes() or (
        corrected[field][0] == pytest.approx(value)
    )


def test_every_form_runs_in_the_loop_and_changes_it(bench: Bench) -> None:
    """No form is a dead branch: each changes a run by more than rounding, and none is left behind by reset."""
    schedule = Schedule(reference=SINE, gains=(60.0, 10.0), seconds=0.6)
    nominal = simulate(AnalyticPlant(bench, noise=0.0), bench, schedule)
    for name in CATALOGUE:
        form = CATALOGUE[name]
        sizes = SIZES | {"coefficient": COEFFICIENTS.get(name.split()[0], 0.0)} | GROWN.get(name, {})
        numbers = {quantity.name: sizes[quantity.name] for quantity in form.parameters}
        changed = with_effects(bench, *NEEDS.get(name, ()), effect(name, **numbers))
        assert kind_of(changed.effects[-1])[0] is form
        plant = AnalyticPlant(changed, noise=0.0)
        run = simulate(plant, bench, schedule)
        assert np.isfinite(run["load_force"]).all(), name
        shown = max(np.ptp(run[field] - nominal[field]) + abs(np.mean(run[field] - nominal[field])) for field in SEEN)
        assert shown > 1e-2, name
        assert simulate(plant, bench, schedule).tobytes() == run.tobytes(), name


GROWN = {one.id: one.seen for one in grown.EFFECTS}
SEEN = ("load_force", "hydraulic_force", "pressure_a", "pressure_b")
SIZES = {
    "ratio": 0.95, "current": 2e-4, "time": 2e-3, "bandwidth": 80.0, "damping": 0.8, "half_width": 2e-4,
    "half_width_negative": 1e-4, "softness": 5e-5, "rate": 0.02, "resistance": 5e9, "time_constant": 0.02,
    "volume_fraction": 0.01, "force": 10.0, "force_positive": 12.0, "force_negative": 8.0, "breakaway_force": 5.0,
    "velocity": 0.01, "stiffness": 3e4, "position": 0.041, "width": 5e-4, "pressure": 5e4, "mass": 0.3,
    "coefficient_positive": 50.0, "coefficient_negative": -20.0,
}  # fmt: skip
COEFFICIENTS = {
    "leakage_internal": 1e-12, "leakage_external": 1e-12, "spring_hardening": 5e6, "friction_viscous": 40.0,
    "valve_null_leakage": 3e-10,
}  # fmt: skip
NEEDS = {"friction_presliding": (effect("friction_coulomb", force=10.0),)}
