# SPDX-License-Identifier: Apache-2.0
"""The textbook bench without effects, compiled by numba: `model.equations` on plain numbers.

`bench` is one record of `model.bench.BENCH_DTYPE` (`Bench.constants()[0]`) everywhere here; the physical state is::

    y = [ p_a   p_b   x_p   x_p'   f_l behind the load cell's amplifier   its rate ]
          Pa    Pa    m     m/s    N                                      N/s
          0     1     2     3      4                                      5

Source: paper eq. q13-q15 and q4, physics.md; `input_gain` carries the erratum's plus sign.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq


@njit
def flow_gains(bench, pressure_a, pressure_b, opening):
    """q_a/u and q_b/u [m3/s/A] of an opened valve; `opening`: any current of the same sign."""
    out, back = eq.edge_drops(bench.supply_pressure, bench.tank_pressure, pressure_a, pressure_b)
    drop_a, drop_b = out if opening >= 0.0 else back
    return bench.valve_gain * eq.signed_root(drop_a), bench.valve_gain * eq.signed_root(drop_b)


@njit
def stiffnesses(bench, position):
    """beta/V [Pa/m3] of both chambers at piston position [m]."""
    return eq.stiffnesses(bench, (bench.bulk_modulus, bench.bulk_modulus), position)


@njit
def pressure_rates(bench, pressure_a, pressure_b, position, velocity, current):
    """p_a', p_b' [Pa/s] at valve current [A]."""
    gain_a, gain_b = flow_gains(bench, pressure_a, pressure_b, current)
    return eq.pressure_rates(bench, stiffnesses(bench, position), (gain_a * current, -gain_b * current), velocity)


@njit
def input_gain(bench, position, pressure_a, pressure_b, opening):
    """g [N/s/A] (eq. q15 with a plus, see the erratum in physics.md), for currents with the sign of `opening`."""
    gain_a, gain_b = flow_gains(bench, pressure_a, pressure_b, opening)
    return eq.force_rate(bench, stiffnesses(bench, position), (gain_a, -gain_b), 0.0)


def rest_state(bench: np.void) -> FloatArray:
    """The physical state y, shape (6,), of a bench at rest (`equations.rest_state`)."""
    return np.array(eq.rest_state(SimpleNamespace(**{name: bench[name] for name in bench.dtype.names or ()})))
