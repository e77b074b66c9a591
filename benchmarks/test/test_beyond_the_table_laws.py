# SPDX-License-Identifier: Apache-2.0
"""Kinds of unnamed physics follow the laws they say: each is found again in a run's log, by finite differences.

All that are or have been sealed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.beyond_the_table.kinds import KINDS, Kind
from benchmarks.test.beyond_the_table_log import (
    AREA_B,
    BENCH,
    GAIN,
    PERIOD,
    QUIET,
    REST,
    ROWS,
    FloatArray,
    Signals,
    logged,
    residuals,
    second,
    seen,
    signals,
)
from benchmarks.test.beyond_the_table_parts import (
    behind_play,
    bump,
    choked,
    covered,
    dammed,
    dragged,
    drawn_down,
    drops,
    followed,
    followed_with_play,
    held,
    hunted,
    kept_back,
    lag,
    late,
    magnetised,
    missed,
    one_sided,
    over_a,
    parted,
    passed,
    path,
    pocketed,
    remembered,
    run_along,
    sagged,
    set_down,
    signed_root,
    slewed,
    slipped,
    squeezed,
    stored,
    strained,
    stubbed,
    throttled,
    unrippled,
    warmth,
)

pytestmark = pytest.mark.study

EXPECTED: dict[str, tuple[str, Callable[[Signals, float, float], FloatArray]]] = {
    "friction_lag": ("motion", lambda s, c, h: c * np.exp(-((lag(s.v, h) / 0.05) ** 2)) * np.tanh(s.v / 2e-3)),
    "bore_score": ("motion", lambda s, c, h: c * bump(s.x, 0.043, h) * np.tanh(s.v / 2e-3)),
    "shear_thinning": ("motion", lambda s, c, h: c * h * s.v / (h + np.abs(s.v))),
    "port_relief": ("pressure_a", lambda s, c, h: -c * np.clip(s.a - h, 0.0, None)),
    "worn_bore": ("pressure_b", lambda s, c, h: c * (s.a - s.b) * bump(s.x, 0.045, h)),
    "hot_leak": ("pressure_a", lambda s, c, h: -c * (s.a - s.b) * warmth(s, h)),
    "rod_film": ("pressure_b", lambda s, c, h: -c * AREA_B * s.v * (s.v > 0.0)),
    "spool_stop": ("pressure_a", lambda s, c, h: -c * np.clip(s.u - h, 0.0, None) * over_a(s)),
    "null_warms": ("pressure_a", lambda s, c, h: c * warmth(s, h) * over_a(s)),
    "return_filter": ("pressure_b", lambda s, c, h: kept_back(s, c)),
    "stop_spring": ("load", lambda s, c, h: c * (s.x - h) * (s.x > h)),
    "rebound_damper": ("load", lambda s, c, h: c * s.v**2 * (s.v > 0.0)),
    "leaf_spring": ("load", lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / h)),
    "cell_pickup": ("sensor", lambda s, c, h: c * s.u),
    "gauge_warms": ("sensor", lambda s, c, h: AREA_B * c * -np.expm1(-PERIOD * np.arange(ROWS) / h)),
    "gauge_snubber": ("sensor", lambda s, c, h: AREA_B * (throttled(s.b, c) - s.b)),
    "gland_pressure": ("motion", lambda s, c, h: c * s.b * np.tanh(s.v / h)),
    "lip_film": ("motion", lambda s, c, h: c * s.v / np.sqrt(np.abs(s.v) + h)),
    "rod_bellows": ("motion", lambda s, c, h: c * (s.x - REST - lag(s.x - REST, h))),
    "cold_start": ("motion", lambda s, c, h: c * np.exp(-PERIOD * np.arange(ROWS) / h) * s.v),
    "weeping_fitting": ("pressure_b", lambda s, c, h: -c * np.sqrt(s.b)),
    "blow_by": ("pressure_a", lambda s, c, h: c * np.clip(s.b - s.a - h, 0.0, None)),
    "floating_ring": ("pressure_b", lambda s, c, h: c * (s.a - s.b) * (1.0 - path(s.x, h) ** 2)),
    "silted_edge": ("pressure_b", lambda s, c, h: c * GAIN * np.clip(s.u, 0.0, None) * np.sqrt(s.b)),
    "jet_force": ("pressure_a", lambda s, c, h: passed(s, s.u / (1.0 + c * drops(s)))),
    "load_null": ("pressure_a", lambda s, c, h: passed(s, s.u - c * (s.a - s.b))),
    "specimen_damping": ("load", lambda s, c, h: c * s.v),
    "grip_mass": ("load", lambda s, c, h: c * second(s.x)),
    "specimen_softens": (
        "load",
        lambda s, c, h: -c * lag(np.abs(s.v) / 0.1, h) * BENCH.spring_stiffness * (s.x - REST),
    ),
    "cell_bypass": ("cell", lambda s, c, h: c * np.clip(-seen(s.x), 0.0, None)),
    "gauge_limit": ("sensor", lambda s, c, h: -AREA_B * c * np.clip(s.b - h, 0.0, None)),
    "encoder_play": ("load", lambda s, c, h: BENCH.spring_stiffness * (behind_play(s.x, c, h) - s.x)),
    "film_squeezed": ("motion", lambda s, c, h: c * squeezed(s.v, h, 8e-3) * np.tanh(s.v / 2e-3)),
    "hose_stiffens": ("motion", lambda s, c, h: c * s.b * (s.x - REST)),
    "backup_ring": ("motion", lambda s, c, h: c * np.clip(s.b - h, 0.0, None) * np.tanh(s.v / 5e-3)),
    "switch_magnet": ("motion", lambda s, c, h: c * (s.x - 0.036) / h * bump(s.x, 0.036, h)),
    "piston_tilts": ("pressure_a", lambda s, c, h: -c * (s.a - s.b) * np.abs(s.x - REST)),
    "slow_relief": ("pressure_b", lambda s, c, h: -c * lag(np.clip(s.b - h, 0.0, None), 0.04)),
    "gap_widens": ("pressure_b", lambda s, c, h: -c * s.b**2),
    "valve_rides": ("pressure_a", lambda s, c, h: passed(s, s.u - c * second(s.x))),
    "edge_chokes": ("pressure_b", lambda s, c, h: choked(s, c, h)),
    "coil_warms": ("pressure_a", lambda s, c, h: passed(s, s.u * (1.0 - c * lag((s.u / 5e-3) ** 2, h)))),
    "conical_spring": ("load", lambda s, c, h: c * np.clip(s.x - REST, 0.0, None) ** 2),
    "specimen_beds_in": (
        "load",
        lambda s, c, h: -c * np.exp(-PERIOD * np.arange(ROWS) / h) * BENCH.spring_stiffness * (s.x - REST),
    ),
    "wire_rope": ("load", lambda s, c, h: c * np.abs(s.x - REST) * path(s.x, h)),
    "bridge_sags": ("sensor", lambda s, c, h: -sagged(s, c)),
    "cell_hysteresis": ("cell", lambda s, c, h: c * path(seen(s.x), h)),
    "gauge_crosstalk": ("sensor", lambda s, c, h: AREA_B * c * s.a),
    "starved_film": ("motion", lambda s, c, h: c * np.sign(s.v) * np.clip(np.abs(s.v) - h, 0.0, None)),
    "spring_bows": ("motion", lambda s, c, h: c * np.clip(REST - s.x, 0.0, None) ** 2 * np.tanh(s.v / 5e-3)),
    "guide_swells": ("motion", lambda s, c, h: c * lag(np.abs(s.v) / 0.1, h) * np.tanh(s.v / 2e-3)),
    "tank_warms": (
        "pressure_a",
        lambda s, c, h: c * np.expm1(-PERIOD * (np.arange(ROWS - 1) + 0.5) / h) * (s.a - s.b),
    ),
    "damper_stub": ("pressure_b", lambda s, c, h: -stubbed(s.b, c, h)),
    "lips_close": ("pressure_b", lambda s, c, h: -c * s.b * np.clip(h - s.b, 0.0, None)),
    "lips_lift": ("pressure_b", lambda s, c, h: c * np.abs(s.v) * (s.a - s.b)),
    "notched_spool": ("pressure_a", lambda s, c, h: passed(s, s.u - c * np.clip(s.u, -h, h))),
    "supply_sets": ("pressure_a", lambda s, c, h: -set_down(s, c, h)),
    "pilot_clogged": ("pressure_a", lambda s, c, h: passed(s, one_sided(s.u, c, 2e-4))),
    "air_spring": ("load", lambda s, c, h: c * ((1.0 - (s.x - REST) / h) ** -1.4 - 1.0)),
    "foam_block": ("load", lambda s, c, h: c * np.clip(s.x - REST, 0.0, None) * s.v),
    "jaws_slip": ("load", lambda s, c, h: -BENCH.spring_stiffness * slipped(s.x, c, h)),
    "cell_rectifies": ("sensor", lambda s, c, h: c * s.u**2),
    "cell_seats": ("cell", lambda s, c, h: -c * np.clip(seen(s.x), -h, h)),
    "cell_slew": ("sensor", lambda s, c, h: slewed(s.f, c, 5e-4) - s.f),
    "blown_lip": ("motion", lambda s, c, h: c * s.a * s.v),
    "eddy_ring": ("motion", lambda s, c, h: c * h**2 * s.v / (h**2 + s.v**2)),
    "dry_rail": ("motion", lambda s, c, h: c / (1.0 + np.exp(-2e3 * (s.x - h))) * np.tanh(s.v / 5e-3)),
    "oil_pot": ("motion", lambda s, c, h: c * (s.v - followed(s.v, 0.0, lambda v, w: (v - w) / h))),
    "bypass_groove": ("pressure_b", lambda s, c, h: c * np.clip(s.x - h, 0.0, None) * signed_root(s.a - s.b)),
    "worn_land": ("pressure_a", lambda s, c, h: c * np.sqrt(BENCH.supply_pressure - s.a)),
    "oil_expands": ("pressure_b", lambda s, c, h: c * np.exp(-PERIOD * (np.arange(ROWS - 1) + 0.5) / h)),
    "motor_saturates": ("pressure_a", lambda s, c, h: passed(s, s.u * h / np.sqrt(h**2 + c * s.u**2))),
    "return_pot": ("pressure_b", lambda s, c, h: dammed(s, c, h)),
    "port_covered": ("pressure_a", lambda s, c, h: -covered(s, c, h)),
    "friction_strut": ("load", lambda s, c, h: c * np.tanh(s.v / h)),
    "rubber_quickens": ("load", lambda s, c, h: c * (s.x - REST) * np.abs(s.v)),
    "memory_foam": (
        "load",
        lambda s, c, h: c * np.clip(s.x - REST - followed(s.x - REST, 0.0, lambda x, w: (x - w) / h), 0.0, None),
    ),
    "gauge_coarse": ("sensor", lambda s, c, h: AREA_B * (c * np.round(s.b / c) - s.b)),
    "cell_gain_warms": ("sensor", lambda s, c, h: c * -np.expm1(-PERIOD * np.arange(ROWS) / h) * s.f),
    "barrel_stretches": ("load", lambda s, c, h: BENCH.spring_stiffness * c * s.b),
    "flyweights": ("motion", lambda s, c, h: -c * s.v**2),
    "scraper_digs": ("motion", lambda s, c, h: c * s.v * (s.v < 0.0)),
    "honed_waves": ("motion", lambda s, c, h: 0.5 * c * (1.0 - np.cos(2.0 * np.pi * s.x / h)) * s.v),
    "lip_relaxes": ("motion", lambda s, c, h: c * np.clip(strained(s.b, h), 0.0, None) * np.tanh(s.v / 5e-3)),
    "pilot_check": ("pressure_b", lambda s, c, h: -c * (s.a - h) * (s.a > h) * np.sqrt(s.b)),
    "lip_pocket": ("pressure_a", lambda s, c, h: -c * pocketed(s.a, 0.02, h)),
    "rod_scuffed": ("pressure_b", lambda s, c, h: -c * (h - s.x) * (s.x < h) * s.b),
    "feedback_link": ("pressure_a", lambda s, c, h: passed(s, s.u - c * (s.x - REST))),
    "flux_creeps": ("pressure_a", lambda s, c, h: passed(s, s.u - c * (s.u - late(s.u, h)))),
    "neighbour_strokes": ("pressure_a", lambda s, c, h: -drawn_down(s, c, h)),
    "cross_wire": ("load", lambda s, c, h: c * np.sin(np.arctan2(s.x - REST, h))),
    "freewheel": ("load", lambda s, c, h: c * np.clip(s.v - run_along(s.v, h, 0.6), 0.0, None)),
    "unbalanced_motor": ("load", lambda s, c, h: c * np.sin(2.0 * np.pi * PERIOD * np.arange(ROWS) / h)),
    "cell_ranges": ("cell", lambda s, c, h: c * seen(s.x) * (np.abs(seen(s.x)) > h)),
    "scale_ripple": ("load", lambda s, c, h: BENCH.spring_stiffness * (unrippled(s.x, c, h) - s.x)),
    "cell_holds": ("sensor", lambda s, c, h: held(s.f, round(c / PERIOD)) - s.f),
    "port_jet": ("motion", lambda s, c, h: -c * s.u**2 * (s.u > 0.0) * (BENCH.supply_pressure - s.a)),
    "ring_rolls": ("motion", lambda s, c, h: c * s.b * path(s.x, h)),
    "eccentric_pinion": ("motion", lambda s, c, h: c * np.sin(2.0 * np.pi * s.x / h)),
    "squeeze_film": ("motion", lambda s, c, h: c * h**3 * s.v / (h - s.x) ** 3),
    "gap_silts": ("pressure_b", lambda s, c, h: c * (1.0 - squeezed(s.v, 0.5, h)) * (s.a - s.b)),
    "pipe_inertia": ("pressure_a", lambda s, c, h: late(over_a(s) * s.u, c) - over_a(s) * s.u),
    "precharged": ("pressure_b", lambda s, c, h: -c * stored(s.b, h)),
    "dither_left": (
        "pressure_a",
        lambda s, c, h: passed(s, s.u + c * np.sin(2.0 * np.pi * PERIOD * (np.arange(ROWS - 1) + 0.5) / h)),
    ),
    "remanence": ("pressure_a", lambda s, c, h: passed(s, s.u + c * magnetised(s.u, h, 0.05))),
    "lands_apart": ("pressure_b", lambda s, c, h: -parted(s, c)),
    "rubber_remembers": ("load", lambda s, c, h: -remembered(s.x, c, h)),
    "magnet_gap": ("load", lambda s, c, h: c * bump(s.x, 0.038, h) * s.v),
    "centrifugal_brake": ("load", lambda s, c, h: c * np.sign(s.v) * (s.v**2 - h**2) * (np.abs(s.v) > h)),
    "cable_swings": ("cell", lambda s, c, h: c * s.v),
    "throat_tapped": ("sensor", lambda s, c, h: BENCH.piston_area * c * s.v**2 * (s.v > 0.0)),
    "counts_lost": ("load", lambda s, c, h: BENCH.spring_stiffness * missed(s.v, c, h)),
    "rod_seal_pressure_friction": ("motion", lambda s, c, h: c * s.b * np.tanh(s.v / h)),
    "side_load_friction": (
        "motion",
        lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / h),
    ),
    "tight_spot_friction": ("motion", lambda s, c, h: c * bump(s.x, h, 2e-3) * np.tanh(s.v / 3e-3)),
    "turbulent_drag": ("motion", lambda s, c, h: c * np.sign(s.v) * s.v**2),
    "relief_cracking_b": ("pressure_b", lambda s, c, h: -c * np.clip(s.b - h, 0.0, None)),
    "scored_bore_leakage": ("pressure_a", lambda s, c, h: -c * (s.a - s.b) * (s.x > h)),
    "hose_creep_a": ("pressure_a", lambda s, c, h: -c * strained(s.a, h) / h),
    "rod_seal_weep_extending": ("pressure_b", lambda s, c, h: -c * s.b * np.clip(np.tanh(s.v / 1e-3), 0.0, None)),
    "valve_hysteresis_play": ("pressure_a", lambda s, c, h: passed(s, dragged(s.u, c, 2e-5))),
    "null_shift_load_pressure": ("pressure_a", lambda s, c, h: passed(s, s.u - c * (s.a - s.b))),
    "supply_hunting": ("pressure_a", lambda s, c, h: hunted(s, c, h)),
    "spring_guide_friction": ("load", lambda s, c, h: c * np.tanh(s.v / h)),
    "carriage_inertia_at_cell": ("load", lambda s, c, h: c * second(s.x)),
    "coil_contact": ("load", lambda s, c, h: c * np.clip(s.x - h, 0.0, None)),
    "encoder_mount_flex": (
        "load",
        lambda s, c, h: BENCH.spring_stiffness * (s.x - REST) * (1.0 / (1.0 + c * BENCH.spring_stiffness) - 1.0),
    ),
    "load_cell_warm_up": ("cell", lambda s, c, h: c * -np.expm1(-PERIOD * np.arange(ROWS) / h)),
    "seal_film_drag": ("motion", lambda s, c, h: c * signed_root(s.v)),
    "piston_lip_friction": ("motion", lambda s, c, h: c * np.abs(s.a - s.b) * np.tanh(s.v / 5e-3)),
    "askew_load_friction": (
        "motion",
        lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / 5e-3),
    ),
    "cable_loop_spring": ("motion", lambda s, c, h: c * (s.x - h)),
    "rod_seal_scratch": ("pressure_b", lambda s, c, h: -c * np.sqrt(s.b)),
    "hose_wall_creep": ("pressure_a", lambda s, c, h: -c * pocketed(s.a, h, h)),
    "bore_worn_mid": ("pressure_b", lambda s, c, h: c * (s.a - s.b) * bump(s.x, 0.04, h)),
    "relief_weeps_a": ("pressure_a", lambda s, c, h: -c * (s.a - h) * (s.a > h)),
    "flow_curve_bends": ("pressure_a", lambda s, c, h: passed(s, s.u / (1.0 + c * np.abs(s.u)))),
    "torque_motor_play": ("pressure_a", lambda s, c, h: passed(s, followed_with_play(s.u, c))),
    "null_warms_up": (
        "pressure_a",
        lambda s, c, h: passed(s, s.u - c * np.expm1(-PERIOD * (np.arange(ROWS - 1) + 0.5) / h)),
    ),
    "coils_touch": ("load", lambda s, c, h: c * np.clip(s.x - h, 0.0, None)),
    "spring_plate_mass": ("load", lambda s, c, h: c * second(s.x)),
    "spring_rubs_guide": ("load", lambda s, c, h: c * np.abs(s.x - REST) * np.tanh(s.v / h)),
    "load_cell_bow": ("cell", lambda s, c, h: c * seen(s.x) ** 2),
    "gauge_span_b": ("sensor", lambda s, c, h: AREA_B * c * s.b),
}
"""Equation, and what it must leave unexplained, by signals, size and shape: a second derivation, from the log alone."""


def test_every_sealed_kind_has_its_law_here() -> None:
    assert {kind.name for kind in KINDS if kind.half == "sealed"} <= EXPECTED.keys()


def test_a_kind_follows_the_law_it_says(each: Callable[..., None]) -> None:
    """Its residual is the law's, number and all; and no equation but its own leaves more than on a clean bench."""
    each([kind for kind in KINDS if kind.name in EXPECTED], follows_its_law, lambda kind: kind.name)


def follows_its_law(kind: Kind) -> None:
    log, clean = logged(kind), residuals(logged(None))
    equation, law = EXPECTED[kind.name]
    found, left = residuals(log), law(signals(log, halfway=equation.startswith("pressure")), kind.size[1], kind.shape)
    miss = (found[equation] - left)[QUIET:-QUIET]
    residual, left = found[equation][QUIET:-QUIET], left[QUIET:-QUIET]
    assert residual @ left / (left @ left) == pytest.approx(1.0, abs=0.03)
    assert np.std(miss) < 0.08 * np.sqrt(np.mean(left**2))
    if kind.equations == ("sensor",):
        return  # that reading stands in other equations; the rates do not know it (test_beyond_the_table_physics.py)
    for other in found.keys() - {*kind.equations, "cell"}:
        assert np.std(found[other][QUIET:-QUIET]) < 2.5 * np.std(clean[other][QUIET:-QUIET]), other
