# SPDX-License-Identifier: Apache-2.0
"""Metrics solved for the loop linearized at rest: one for each gain of a table, and one for all other gains.

In the certified range of K_p, the metric must decay along the frozen loop F + G K without a correction: P solves the
discrete Lyapunov equation of that loop, sped up by a part of its own decay. Outside, the correction closes the loop, so
that the metric is that of the best correction: P solves the discrete Riccati equation, and the loop under its feedback
decays at some 20 1/s. Both are for the nominal bench at rest; training and certificate must show that they hold
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_discrete_are, solve_discrete_lyapunov

from hydro_bridge.settings import quantity
from hydro_bridge.signals import FloatArray
from hydro_filter.model.coordinates import LOOP
from hydro_filter.model.linearization import linearize
from hydro_filter.model.loop import closing_current, memories, rest_measurement, step_of
from hydro_filter.model.observer import settle
from hydro_filter.model.parts import Loop


@dataclass(frozen=True, kw_only=True)
class MetricDesign:
    """Loops for which metrics are solved."""

    gain_low: Annotated[float, quantity("1/s", 1.0, 1e6)] = 10.0
    """The certified range's lower end."""
    gain_high: Annotated[float, quantity("1/s", 1.0, 1e6)] = 95.0
    """The certified range's upper end: the rollouts turn unstable some 20 1/s above."""
    gain_share: Annotated[float, quantity("-", 0.1, 1.0)] = 0.8
    """The upper end is at most this share of the gain at which the loop at rest decays no more."""
    gain_step: Annotated[float, quantity("1/s", 0.5, 50.0)] = 5.0
    """Least step between the table's gains."""
    velocity_compensation: Annotated[float, quantity("-", 0.0, 1.0)] = 1.0
    """C_1 of the law, at C_2 = 1."""
    own_decay: Annotated[float, quantity("-", 0.0, 0.95)] = 0.3
    """Share of a loop's own decay that its metric is solved for."""
    foreign_weights: tuple[Annotated[float, quantity("-", 1e-9, 1e9)], ...] = (
        1e-2, 1e-2, 1e-2, 1.0, 1e-2, 1.0, 1e-2, 1e-2,
    )  # fmt: skip
    """Of the loop coordinates' squares in the Riccati equation, each above 0; the Lyapunov equations have ones."""
    added_weight: Annotated[float, quantity("-", 1e-9, 1e9)] = 1e-2
    """The same of coordinates that a bench file adds."""
    effort: Annotated[float, quantity("-", 1e-4, 100.0)] = 1e-2
    """Weight of the correction's square in it, in units of 0.14 of the valve's current."""
    floor: Annotated[float, quantity("-", 1e-9, 1e-2)] = 1e-6
    """Smallest eigenvalue of M, over its largest entry."""


MOST_STEPS = 48
"""Of the table: a bench whose range is wider than the nominal one's has wider steps."""
MOST_TRIED = 600
"""Gains at which `decaying_range` asks, at most."""
ANY_GAIN = (1.0, 2.0, 5.0, *(10.0 * place for place in range(1, 21)))
"""K_p [1/s] of `require_decay`."""


class MetricParts(NamedTuple):
    """The metric as arrays for the kernels."""

    gains: FloatArray
    """K_p [1/s] of the table's factors but the last, evenly spaced, shape (n,); the ends are the certified range."""
    table: FloatArray
    """Cholesky factors by rows, shape (n + 1, 36) for eight coordinates; the last is for uncertified gains."""
    floor: float
    """Smallest eigenvalue of M, above 0."""


def rest_loop(
    loop: Loop, proportional_gain: float, velocity_compensation: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return F, G, K of the bench at rest as its sensors show it, about a closed valve."""
    step, memory, closing, x = step_of(loop), memories()[0], closing_current(loop), rest_measurement(loop.model)
    settle(loop, memory, x, closing, 0.0)
    scales = float(velocity_compensation), 1.0
    linearize(loop, memory["hidden"], x, 1e-9, closing, float(proportional_gain), scales, step)
    return step.transition.copy(), step.push.copy(), step.feedback.copy()


def lyapunov(closed: FloatArray, weights: FloatArray, own_decay: float) -> FloatArray:
    """Return the Lyapunov solution P of a closed loop for a share of its own decay rate.

    Raises ValueError if the loop does not decay.
    """
    slowest = float(np.abs(np.linalg.eigvals(closed)).max())
    if slowest >= 1.0:
        raise ValueError("a metric is wanted of a loop that does not decay: the certified range of K_p is too wide")
    sped = closed / slowest**own_decay
    return np.asarray(solve_discrete_lyapunov(sped.T, np.diag(weights)))


def require_decay(loop: Loop, velocity_compensation: float = 1.0) -> None:
    """Raise ValueError if the loop at rest decays at no gain: no metric of it exists, whatever its rollouts do."""
    closed = (_closed(loop, gain, velocity_compensation) for gain in ANY_GAIN)
    if any(float(np.abs(np.linalg.eigvals(each)).max()) < 1.0 for each in closed):
        return
    valve, dead = 1e3 * loop.model.spool_age, 1e3 * loop.model.delay
    raise ValueError(
        f"no gain has a certificate: the loop of this bench, whose valve is {valve:.1f} ms late by its lag and "
        f"{dead:.1f} ms by its dead time, decays at no K_p from {ANY_GAIN[0]:g} to {ANY_GAIN[-1]:g} 1/s"
    )


def decaying_range(loop: Loop, design: MetricDesign) -> MetricDesign:
    """Return the design with a range that ends at a share of the gain at which the loop at rest decays no more.

    Dry friction and overlap, which the linearized loop has none of, hold a real bench still at gains beyond that: its
    rollouts are stable where its loop is not. The share is the reserve that the range has below unstable rollouts.

    Raises ValueError if the loop does not decay at the range's lower end, or the reserve leaves no range.
    """
    low, share = design.gain_low, design.gain_share
    high = design.gain_high / share
    for gain in np.arange(low, high, max(1.0, (high - low) / MOST_TRIED)):
        if float(np.abs(np.linalg.eigvals(_closed(loop, float(gain), design.velocity_compensation))).max()) >= 1.0:
            break
    else:
        return design
    if gain == low:
        raise ValueError(
            f"the loop does not decay at K_p = {low:g} 1/s, the lower end of the certified range: the bench file "
            "is not of this box, or its valve's lag and dead time are too long for it"
        )
    if not share * gain > low:
        raise ValueError(
            f"no range of gains has a certificate: rollouts are stable from K_p = {low:g} 1/s on, and the loop at rest "
            f"decays no more from {gain:g} 1/s on, of which {100.0 * share:.0f} % are allowed"
        )
    return replace(design, gain_high=min(design.gain_high, float(share * gain)))


def riccati(free: FloatArray, push: FloatArray, weights: FloatArray, effort: float) -> tuple[FloatArray, FloatArray]:
    """Return P and the feedback [per unit of `push`] of the best correction."""
    column = push[:, np.newaxis]
    weight = np.asarray(solve_discrete_are(free, column, np.diag(weights), np.array([[effort]])))
    feedback = -(push @ weight @ free) / (effort + push @ weight @ push)
    return weight, feedback


def design_table(loop: Loop, design: MetricDesign) -> MetricParts:
    """Solve all metrics of a design, each scaled to 1 along the load force (raises as `lyapunov`)."""
    gains = _gains(design)
    closed = [_closed(loop, gain, design.velocity_compensation) for gain in gains]
    rows = [lyapunov(each, np.ones(len(loop.scale)), design.own_decay) for each in closed]
    free, push, _ = rest_loop(loop, float(gains[0]))
    unit = 0.14 * loop.current_max
    rows.append(riccati(free, unit * push, _foreign_weights(loop, design), design.effort)[0])
    return MetricParts(gains, np.array([factor_entries(row / row[3, 3]) for row in rows]), design.floor)


def correcting_feedback(loop: Loop, design: MetricDesign) -> FloatArray:
    """Return K [A] of the best correction about the bench at rest, of each coordinate."""
    free, push, _ = rest_loop(loop, design.gain_low)
    unit = 0.14 * loop.current_max
    return unit * riccati(free, unit * push, _foreign_weights(loop, design), design.effort)[1]


def _foreign_weights(loop: Loop, design: MetricDesign) -> FloatArray:
    return np.array([*design.foreign_weights, *[design.added_weight] * (len(loop.scale) - LOOP)])


def _gains(design: MetricDesign) -> FloatArray:
    """K_p [1/s] of the table."""
    low, high, step = design.gain_low, design.gain_high, design.gain_step
    wide = high - low > MOST_STEPS * step
    gains = np.linspace(low, high, MOST_STEPS + 1) if wide else np.arange(low, high + 0.5 * step, step)
    return np.asarray(gains, np.float64)


def _closed(loop: Loop, proportional_gain: float, velocity_compensation: float) -> FloatArray:
    """F + G K at rest."""
    free, push, feedback = rest_loop(loop, float(proportional_gain), velocity_compensation)
    return free + np.outer(push, feedback)


def factor_entries(weight: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of a metric, row by row: of 8 coordinates, shape (36,)."""
    return np.asarray(cholesky(weight, lower=True)[np.tril_indices(len(weight))])
