# SPDX-License-Identifier: Apache-2.0
"""Second-order lags sampled exactly: the change of state over a step.

::

    s'' + 2 D w s' + w^2 s = w^2 u          state (s, s'), w = 2 pi bandwidth

    step_zero_order_hold     u constant over the step
    step_first_order_hold    u linear over the step

The exponential of the system's matrix is a Taylor series over a 2^-SQUARING_COUNT-th of the step, squared that often:
it is smooth in bandwidth and damping, where the closed form changes its kind at a damping of 1. It holds to rounding up
to 2 D w step = 30. Source: Moler and Van Loan, SIAM Review 45(1), 2003, method 3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol

SQUARING_COUNT, SERIES_TERM_COUNT = 6, 14

LagState = tuple[Symbol, Symbol]


def step_zero_order_hold(
    at: Any, bandwidth: Symbol, damping: Symbol, state: LagState, signal: Symbol
) -> tuple[LagState, Symbol]:
    """Return the state after a step under a zero-order hold of the input, and the mean of s over the step."""
    omega = 2.0 * np.pi * bandwidth
    reach = omega * at.step
    # s, s'/w, the signal, the integral of s: time in units of 1/w
    e = _exponential([[0, 1, 0, 0], [-1, -2.0 * damping, 1, 0], [0, 0, 0, 0], [1, 0, 0, 0]], reach)
    s, rate = state
    moved = at.hoist(e[0, 0]) * s + at.hoist(e[0, 1] / omega) * rate + at.hoist(e[0, 2]) * signal
    turned = at.hoist(omega * e[1, 0]) * s + at.hoist(e[1, 1]) * rate + at.hoist(omega * e[1, 2]) * signal
    mean = at.hoist(e[3, 0] / reach) * s + at.hoist(e[3, 1] / reach / omega) * rate + at.hoist(e[3, 2] / reach) * signal
    return (moved, turned), mean


def step_first_order_hold(
    at: Any, bandwidth: Symbol, damping: Symbol, state: LagState, early: Symbol, late: Symbol
) -> LagState:
    """Return the state after a step under a first-order hold of the input, from `early` to `late`."""
    omega = 2.0 * np.pi * bandwidth
    reach = omega * at.step
    # s, s'/w, the signal, its slope: time in units of 1/w
    e = _exponential([[0, 1, 0, 0], [-1, -2.0 * damping, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]], reach)
    s, rate = state
    moved, turned = (
        at.hoist(unit * e[i, 0]) * s
        + at.hoist(unit * e[i, 1] / omega) * rate
        + at.hoist(unit * (e[i, 2] - e[i, 3] / reach)) * early
        + at.hoist(unit * e[i, 3] / reach) * late
        for i, unit in ((0, 1.0), (1, omega))
    )
    return moved, turned


def lag_rates(bandwidth: Symbol, damping: Symbol, state: LagState, signal: Symbol) -> dict[str, Symbol]:
    """Return s'' as the rate of the state `rate`, for solvers in continuous time."""
    omega = 2.0 * np.pi * bandwidth
    return {"rate": omega * (omega * (signal - state[0]) - 2.0 * damping * state[1])}


def _exponential(system: list[list[Symbol]], reach: Symbol) -> Symbol:
    from casadi import SX, horzcat, vertcat

    small = vertcat(*(horzcat(*row) for row in system)) * (reach / 2.0**SQUARING_COUNT)
    result = unit = SX.eye(len(system))
    for k in range(SERIES_TERM_COUNT, 0, -1):
        result = unit + small @ result / k
    for _ in range(SQUARING_COUNT):
        result = result @ result
    return result
