# SPDX-License-Identifier: Apache-2.0
"""Effects against closed forms; simulated, and along a record, they mean the same; a bench file carries them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_core.files import bench_digest
from hydro_diagnosis.effects import CANDIDATES, LIBRARY, Effect, EffectHypothesis
from hydro_diagnosis.effects.base import BLOCKS, CHANNELS, MachineScales, scale_bounds
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import WindowSimulation
from hydro_diagnosis.preprocessing.smoothing import TOTAL_WIDTH, smooth_kinematic
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report.corrected_bench import claims_of, corrected_bench
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment as Drive
from hydro_sim.model import grammar, tables
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import CATALOGUE, label
from hydro_sim.model.laws import Law, Signals
from hydro_sim.model.tables import Table
from tests.checks import each
from tests.segments import apart, claim, driven, left_by, problem_in

BENCH = Bench.nominal()
ADAPTED = [effect.adapted(BENCH) for effect in CANDIDATES]
EFFECTS = [effect.adapted(BENCH) for effect in LIBRARY]
STEP = 1e-3


def test_a_rise_towards_standstill_is_gone_at_the_top_speed() -> None:
    stribeck = next(one for one in ADAPTED if one.id == "friction_stribeck")
    found = scale_bounds(stribeck, MachineScales(force=100.0, speed=0.6, stroke=0.05))
    velocity = next(one for one in found.parameters if one.name == "velocity")
    assert np.exp(-np.square(0.6 / velocity.high)) == pytest.approx(0.05, abs=1e-3)  # else it passes for dry friction


def test_effect_shows_only_where_it_acts_and_vanishes_at_its_neutral_value(problem: Problem) -> None:
    nothing = problem.residual([])

    def check(effect: Effect) -> None:
        change = (
            problem.residual([EffectHypothesis(effect, {one.name: one.start_values[0] for one in effect.parameters})])
            - nothing
        )
        power = np.bincount(problem.layout.channel, np.square(change), len(CHANNELS))
        shown = {CHANNELS[k] for k in np.flatnonzero(power > 1e-9 * power.max())}
        may = {name for block in effect.blocks for name in BLOCKS[block]} | {"motion"}  # forces reach the motion
        assert shown and shown <= may
        if effect.parameters[0].smallest_reported > 0.0 and "soft" not in effect.label:
            neutral = EffectHypothesis(effect, {one.name: one.neutral for one in effect.parameters})
            assert np.max(np.abs(problem.residual([neutral]) - nothing)) < 1e-6

    each([effect for effect in ADAPTED if not effect.needs], check, lambda effect: effect.label)


def test_air_in_rigid_oil_is_a_polytropic_gas() -> None:
    pressure = np.array([2e5, 1e6, 1e7])
    share, absolute = 0.01, pressure + 101325.0
    gas = share * (101325.0 / absolute) ** (1.0 / 1.4)
    soft = claim("entrained_air").effect.modulus(np.full(3, 1e15), pressure, {"volume_fraction": share})
    assert np.allclose(soft, 1.4 * absolute * (1.0 - share + gas) / gas, rtol=1e-4)


def test_a_line_settles_where_its_drop_is_that_of_the_flow_and_as_fast_as_it_says() -> None:
    """One edge to 0 Pa: s = p - R K sqrt(s); a small step of the source decays with T / (1 + R q'(s))."""
    source, edge, resistance, lag = 16e6, 1e-8, 5e10, 0.05
    steady = ((((edge * resistance) ** 2 + 4.0 * source) ** 0.5 - edge * resistance) / 2.0) ** 2
    given = np.full(1000, source)
    given[1:] += 1e3
    nothing, opened = np.zeros(1000), np.full(1000, edge)
    found = Memory(STEP).line_pressure(given, (opened, nothing, nothing, nothing), resistance, lag)
    assert found[0] == pytest.approx(steady, rel=1e-9)
    gain = resistance * edge / (2.0 * steady**0.5)
    left = (found[2:100] - found[-1]) / (found[1:99] - found[-1])
    np.testing.assert_allclose(left, np.exp(-STEP * (1.0 + gain) / lag), rtol=2e-3)


def test_a_volume_behind_an_orifice_settles_where_both_flows_agree_and_as_fast_as_it_says() -> None:
    """K_1 sqrt(P - p) = K_2 sqrt(p); a small step of P decays with the volume over the slopes of both flows."""
    given, edge, outlet, capacity = np.full(400, 8e6), 1e-8, 2e-8, 1e-12
    given[1:] += 1e3
    nothing = np.zeros(400)
    found = Memory(STEP).volume_pressure((np.full(400, edge), given, nothing, nothing), capacity, outlet=(outlet, 0.0))
    steady = 8e6 / (1.0 + (outlet / edge) ** 2)
    assert found[0] == pytest.approx(steady, rel=1e-3)
    slopes = edge / (2.0 * (8e6 - steady) ** 0.5) + outlet / (2.0 * steady**0.5)
    left = (found[2:30] - found[-1]) / (found[1:29] - found[-1])
    np.testing.assert_allclose(left, np.exp(-STEP * slopes / capacity), rtol=2e-2)


def test_a_pump_that_cannot_give_more_sags_as_its_volume_says_to_where_both_flows_agree() -> None:
    """p' = (Q - K sqrt(p)) beta / V, from the relief pressure to p = (Q / K)^2."""
    limit, edge, relief, capacity = 8e-6, 4e-9, 16e6, 3e-13
    opened = np.where(np.arange(4000) < 100, 0.0, edge)
    nothing = np.zeros(4000)
    found = Memory(STEP).volume_pressure((opened, nothing, nothing, nothing), capacity, flow=limit, most=relief)
    np.testing.assert_allclose(found[:100], relief)
    rate = (limit - edge * relief**0.5) / capacity
    assert found[101] - found[100] == pytest.approx(rate * STEP, rel=1e-2)
    assert found[-1] == pytest.approx((limit / edge) ** 2, rel=1e-2)


def test_effects_stay_within_what_a_bench_allows() -> None:
    light = replace(BENCH, spring_stiffness=1.0, viscous_friction=0.0, moving_mass=0.01, area_ratio=1.0)
    for effect in (one.adapted(light) for one in LIBRARY):
        for bound in ("low", "high"):
            effect.correct(light, {one.name: getattr(one, bound) for one in effect.parameters})
    weak = replace(light, supply_pressure=3e6, tank_pressure=2e5)
    assert claim("tank_pressure").effect.correct(weak, {"pressure": 5e6}).tank_pressure < weak.supply_pressure


def pushed(force: float) -> SegmentModel:
    """A bench at the spring's rest with its valve shut, and more force on the piston than the spring takes."""
    p_b = 8e6
    p_a = BENCH.area_ratio * p_b + force / BENCH.piston_area
    values = {"valve_current": 0.0, "piston_position": BENCH.spring_rest_position, "pressure_a": p_a, "pressure_b": p_b}
    channels = {name: np.full(400, value) for name, value in values.items()}
    return SegmentModel(Segment("pushed", 0.0, STEP, channels), BENCH)


BEGINS = np.array([50])


@pytest.mark.parametrize(
    ("label", "values", "moves"),
    [
        ("friction_coulomb", (11.0,), False),
        ("friction_coulomb", (9.0,), True),
        ("friction_coulomb:directional", (9.0, 99.0), True),
        ("friction_stribeck", (11.0, 0.01), False),
    ],
)
def test_piston_sticks_exactly_as_far_as_friction_reaches(label: str, values: tuple[float, ...], moves: bool) -> None:
    simulation = WindowSimulation(pushed(10.0), [claim(label, *values)])
    position = simulation.readings(simulation.recorded[:, BEGINS], BEGINS, 100)["piston_position"]
    travel = np.abs(position - BENCH.spring_rest_position).max()
    assert travel > 1e-7 if moves else travel < 1e-12


def test_sliding_piston_is_stopped_and_stays() -> None:
    simulation = WindowSimulation(pushed(0.0), [claim("friction_coulomb", 40.0)])
    start = simulation.recorded[:, BEGINS]
    start[1] = 0.02
    position = simulation.readings(start, BEGINS, 100)["piston_position"][:, 0]
    assert position[-1] == position[-40] > BENCH.spring_rest_position


def test_friction_is_averaged_over_the_velocities_within_the_test_function() -> None:
    """Breaking loose at 5 m/s^2, a Stribeck rise is passed in some milliseconds."""
    acceleration, strength, width = 5.0, 6.0, 0.012
    time = (np.arange(400) - 200.0) * STEP
    channels = {"piston_position": 0.04 + 0.5 * acceleration * time**2}
    model = SegmentModel(Segment("loose", 0.0, STEP, channels), BENCH)
    got = smooth_kinematic(model.dry_friction([claim("friction_stribeck", strength, width)]))

    fine = np.linspace(-8.0, 8.0, 4001)
    bell = np.exp(-0.5 * (fine / TOTAL_WIDTH) ** 2)
    velocity = acceleration * (time[:, None] + fine * STEP)
    true = (strength * np.sign(velocity) * np.exp(-((velocity / width) ** 2))) @ bell / bell.sum()
    np.testing.assert_allclose(got[50:350], true[50:350], atol=0.06 * strength)
    assert np.abs(got - true)[204:212].max() < 0.03 * strength  # where it is told from Coulomb friction


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_intervals_of_a_stribeck_rise_hold_whatever_its_exponent(exponent: float) -> None:
    """The form that is claimed is 2, and what fits as well may be 1 (Tustin 1947)."""
    sizes = {"breakaway_force": 10.0, "velocity": 0.03}
    effects = {"friction_coulomb": {"force": 10.0}, "friction_stribeck": {**sizes, "exponent": exponent}}
    drive = Drive(seconds=20, waveform="multisine", amplitude=260, frequency=0.7, kp=60, ki=10)
    states = record_offline(truth_from_mapping({"profile": "nominal", "effects": effects}), [drive], seed=3).states
    problem, claims = problem_in(states), (claim("friction_coulomb", 10.0), claim("friction_stribeck", *sizes.values()))
    for _ in range(3):
        problem = problem.reweighted(claims)
        found = fit(problem, claims)
        claims = found.claims
    for bound, true in zip(intervals(problem, found), (10.0, *sizes.values()), strict=True):
        assert bound.low <= true <= bound.high


def test_every_value_that_a_diagnosis_may_report_is_simulated() -> None:
    for effect in EFFECTS:
        kind = CATALOGUE[label(claim(effect.label).to_mapping())]
        simulated = {quantity.name: quantity for quantity in kind.parameters}
        for one in effect.parameters:
            assert simulated[one.name].low <= one.low and one.high <= simulated[one.name].high, effect.label


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.label)
def test_simulation_and_diagnosis_mean_the_same_effect(effect: Effect) -> None:
    """Of windows the RMS of the difference after up to 40 ms, over the signal's range."""
    claims = [*map(claim, effect.needs), claim(effect.label)]
    run = driven(replace(BENCH, effects=tuple(one.to_mapping() for one in claims)))
    with_it, without = apart(*run, claims), apart(*run, claims[:-1])
    brief = effect.label == "friction_stribeck"  # a rise that this motion passes within milliseconds
    assert left_by(run[0], claims) < (0.7 if brief else 0.05)
    assert max(with_it.values()) < 2e-4
    assert any(without[name] > 20.0 * with_it[name] for name in with_it)


LIMITS = {
    "position": (0.02, 0.06), "velocity": (-0.3, 0.3), "pressure_difference": (-5e6, 5e6), "current": (-0.02, 0.02),
    "force": (-400.0, 400.0), "pressure_a": (3e6, 9e6), "pressure_b": (3e6, 9e6), "speed": (0.0, 0.3),
}  # fmt: skip
SHARES = {
    "even quadratic uneven damping": 0.02, "even quadratic opening": -0.1, "null by velocity": 0.1,
    "quadratic opening": -0.1, "cubic opening": -0.1, "beyond opening": -0.3, "gain by past": -0.1,
    "null by opening and": -0.1, "absolute null by": -0.1,
}  # fmt: skip
"""Of the typical size: a valve that opens further makes this loop swing."""
PASSED = {
    "position": 0.038, "velocity": 0.02, "speed": 0.02, "pressure_difference": -1e6, "pressure_a": 6e6,
    "pressure_b": 9e6, "current": 1e-4, "opening": 5e-4, "hydraulic_force": 50.0, "load_force": 50.0,
}  # fmt: skip
"""Thresholds that this motion passes."""
TERMS: tuple[Law | Table, ...] = (*grammar.LAWS, *grammar.LAWS_WITH_REVERSAL_VELOCITY[::4], *grammar.TABLES)
DRAG, TABLE = grammar.FORMS["motion", "quadratic drag"], grammar.FORMS["load", "table over position"]


def claimed(law: Law | Table) -> EffectHypothesis:
    """A term at its typical size; a table goes up and down."""
    effect = closure(law, BENCH, LIMITS[law.variable] if isinstance(law, Table) else (0.0, 1.0))
    amplitudes = [one for one in effect.parameters if one.smallest_reported > 0.0]
    share = next((one for form, one in SHARES.items() if law.form.startswith(form)), 1.0)
    sizes = {one.name: share * one.start_values[0] * (-0.5) ** (k % 2) for k, one in enumerate(amplitudes)}
    starts = effect.start_values()
    numbers = law.shape_parameters if isinstance(law, Law) else ()
    passed = {one.name: PASSED[one.threshold_signal] for one in numbers if one.threshold_signal}
    return EffectHypothesis(effect, {**starts[len(starts) // 2], **passed, **sizes})


def entry(term: EffectHypothesis) -> dict[str, Any]:
    return term.effect.to_closure(term.values)


@pytest.mark.parametrize("every", [14, pytest.param(1, marks=pytest.mark.study)])
def test_simulation_and_diagnosis_mean_the_same_term(every: int) -> None:
    def check(law: Law | Table) -> None:
        term = claimed(law)
        wide = "difference" in law.form or law.equation == "pressure"  # p_a is mostly below p_b
        run = driven(replace(BENCH, closures=(entry(term),)), 560.0 if wide else 280.0)
        with_it, without = apart(*run, [term]), apart(*run, [])
        beyond = "acceleration" in law.form  # than the test function's bandwidth
        assert left_by(run[0], [term]) < (0.4 if beyond else 0.05)
        assert max(with_it.values()) < 1e-4  # some turn round within a sample
        assert any(without[name] > 100.0 * with_it[name] for name in with_it)

    each(TERMS[::every], check, lambda law: f"{law.equation} {law.form}")


def test_closures_survive_the_corrected_bench_and_its_file(tmp_path: Path) -> None:
    claims = [claimed(DRAG), claimed(TABLE)]
    path = tmp_path / "corrected.yaml"
    path.write_text(yaml.safe_dump(corrected_bench(BENCH, claims).to_mapping()))
    back = claims_of(Bench.load(path))
    assert [(one.effect.label, one.values) for one in back] == [(one.effect.label, one.values) for one in claims]
    assert isinstance(back[1].effect, Closure) and back[1].effect.limits == LIMITS["position"]
    assert Bench.load(path).digest == bench_digest.digest(bench_digest.read_parameters(path)) != BENCH.digest


def test_a_table_is_constant_beyond_what_was_seen() -> None:
    table = grammar.FORMS["motion", "table over velocity"]
    numbers = [-0.1, 0.2, *np.arange(tables.KNOTS, dtype=float)]
    found = table.value(Signals(velocity=np.array([-9.0, -0.1, 0.05, 0.2, 9.0])), BENCH, numbers)
    np.testing.assert_allclose(found, [1.0, 1.0, 0.5 * (tables.KNOTS - 1), tables.KNOTS - 2, tables.KNOTS - 2])


def test_closures_that_cannot_be_simulated_are_refused() -> None:
    drag, table = entry(claimed(DRAG)), entry(claimed(TABLE))
    for closures, sentence in (
        ("drag", "'closures' is a list of mappings"),
        ([{**drag, "parameters": {}}], "lacks its parameter coefficient"),
        ([drag] * 7, "7 closures are more than the 6"),
        ([{**table, "parameters": {**table["parameters"], "low": 0.2, "high": 0.2}}], "low must be below high"),
        ([{**table, "parameters": {**table["parameters"], "value_3": float("nan")}}], "value_3"),
    ):
        with pytest.raises(ValueError, match=sentence):
            Bench.from_mapping({**BENCH.to_mapping(), "closures": closures})
    with pytest.raises(ValueError, match="closures stand under 'closures'"):
        replace(BENCH, effects=({"id": "closure", **drag},))
