# SPDX-License-Identifier: Apache-2.0
"""Each kind of unnamed physics acts in the equation it says and in no other, and not at all where its size is 0.

Rates at drawn states: which ones a kind changes, what is conserved, what is dissipated.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.beyond_the_table import plant
from benchmarks.beyond_the_table.kinds import KINDS, NAMES, Kind
from benchmarks.beyond_the_table.physics.places import MEMORY
from benchmarks.beyond_the_table.physics.rates import all_rates
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.equations import CELL_RATE, POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from benchmarks.foreign_truth.recordings import reference

FloatArray = npt.NDArray[np.float64]
pytestmark = pytest.mark.study
BENCH = numbers()
AREA_B = BENCH.area_ratio * BENCH.piston_area
CORNER = 2.0 * math.pi * BENCH.load_cell_bandwidth
SIZED = [kind for kind in KINDS if kind.name != "spool_rate"]
"""Those whose size is not a limit (of which none is infinite)."""
OWN = {"hose_memory": 6e6, "gauge_snubber": 1e7, "spool_rate": 5e-3, "friction_lag": 0.05, "flexible_mount": 1e-3,
       "rod_bellows": 1e-2, "slow_relief": 1e6, "damper_stub": 1e7, "pilot_clogged": 5e-3, "jaws_slip": 1e-2,
       "cell_slew": 200.0, "oil_pot": 0.05, "return_pot": 1e6, "memory_foam": 1e-2,
       "lip_relaxes": 8e6, "lip_pocket": 6e6, "flux_creeps": 5e-3, "freewheel": 0.05, "cell_holds": 200.0,
       "pipe_inertia": 2e-5, "remanence": 5e-3, "rubber_remembers": 1e-2, "counts_lost": 1e-3,
       "hose_creep_a": 6e6, "valve_hysteresis_play": 5e-3, "hose_wall_creep": 6e6,
       "torque_motor_play": 5e-3}  # fmt: skip
"""Scale of a kind's own state, where it is not 1."""
GIVING = {"rod_bellows", "hose_stiffens", "switch_magnet", "oil_pot", "flyweights", "port_jet", "ring_rolls",
          "eccentric_pinion", "cable_loop_spring"}  # fmt: skip
"""Forces on the piston that are no friction: what they take, they give back, or some of it."""


def changed(kind: Kind, seed: int) -> tuple[FloatArray, FloatArray]:
    """A drawn state, and what the kind adds to its rates, the kind's own left out."""
    random = np.random.default_rng(seed)
    state, there, none = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    state[[PRESSURE_A, PRESSURE_B]] = random.uniform(4.5e6, 7.5e6), random.uniform(5e6, 13e6)
    state[[POSITION, VELOCITY]] = random.uniform(0.025, 0.055), random.uniform(-0.2, 0.2)
    state[MEMORY] = random.uniform(0.1, 0.9) * OWN.get(kind.name, 1.0)
    current = random.uniform(-0.01, 0.01)
    all_rates(NAMES.index(kind.name), kind.size[1], kind.shape, BENCH, 1.1, current, 0.1, state, there)
    all_rates(-1, 0.0, 1.0, BENCH, 1.1, current, 0.1, state, none)
    there[MEMORY] = none[MEMORY]
    return state, there - none


def test_a_kind_moves_the_states_of_its_equation_alone(each: Callable[..., None]) -> None:
    """What leaves one chamber for the other arrives there; what the load's cell reads, the piston feels."""
    each(KINDS, moves_its_own_states, lambda kind: kind.name)


def moves_its_own_states(kind: Kind) -> None:
    own = {
        "motion": {VELOCITY},
        "load": {VELOCITY, CELL_RATE},
        "pressure_a": {PRESSURE_A},
        "pressure_b": {PRESSURE_B},
    }
    allowed = set().union(*(own.get(equation, set()) for equation in kind.equations))
    moved: set[int] = set()
    for seed in range(40):
        state, change = changed(kind, seed)
        moved |= set(np.flatnonzero(change).tolist())
        volume_a = BENCH.dead_volume_a + BENCH.piston_area * state[POSITION]
        volume_b = BENCH.dead_volume_b + AREA_B * (BENCH.stroke - state[POSITION])
        gained_a = volume_a * change[PRESSURE_A] / BENCH.bulk_modulus
        gained_b = volume_b * change[PRESSURE_B] / BENCH.bulk_modulus
        if kind.equations == ("pressure_a", "pressure_b"):
            assert gained_a + gained_b == pytest.approx(0.0, abs=1e-15)
            assert gained_a * (state[PRESSURE_A] - state[PRESSURE_B]) <= 0.0
        if kind.equations == ("load",):
            assert BENCH.moving_mass * change[VELOCITY] == pytest.approx(-change[CELL_RATE] / CORNER**2, rel=1e-9)
        if kind.equations == ("motion",) and kind.name not in GIVING:
            assert change[VELOCITY] * state[VELOCITY] <= 0.0, "friction takes power out"
    assert moved == allowed


def test_a_kind_of_size_0_is_not_there(each: Callable[..., None]) -> None:
    each(SIZED, vanishes, lambda kind: kind.name)


def vanishes(kind: Kind) -> None:
    wanted, noise = reference("steps", 400, 3), np.zeros((400, 4))
    none = plant.run(numbers(), -1, 0.0, 1.0, wanted, gain=80.0, noise=noise, quantum=0.0)
    there = plant.run(numbers(), NAMES.index(kind.name), 0.0, kind.shape, wanted, gain=80.0, noise=noise, quantum=0.0)
    np.testing.assert_allclose(there, none, rtol=1e-6, atol=1e-9)
