# SPDX-License-Identifier: Apache-2.0
"""Enclosure of one sample of the closed loop over a box: F + G K, and the directions of the disturbances.

The Jacobian depends on states and bench through few quantities. With P_a = A p_a, P_b = alpha A p_b, f_h = P_a - P_b
and z = g s, s the valve's opening and g the force rate per ampere at the sample's begin::

    f_h' = -c x' + (1 + m) z - nu f_h - eta x + ...           c     stiffness of the oil, beta A^2/V_a + ...
    z''  = w^2 (g u - z) - 2 d w z'                           nu    pressures' effect on the flows, by |s|, and leaks
    x''  = (f_h - b x' - k x) / M                             eta   position's effect on beta/V, by p_a', p_b'
    f_l''= w_c^2 (k x - f_l) - 2 d_c w_c f_l'                 m     mean change of g within the sample

    g u  = a nu^ f_h - a K_p f_l + a eta^ x + C_1 chi c x'_box        a = g/g^ = chi zeta, zeta = c/c^; ^: the law's

chi is the law's velocity compensation over the bench's own, 1 for a bench known to the law. Both ratios are weighted
means of the chambers' ratios, so that their bounds are those at the ends. Each quantity but the smallest is a symbol of
an affine set; the sample is the Taylor series of the state's transition, entries may vary within it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.region.certified_region import Bounds, CertifiedRegion
from hydro_filter.region.interval import AffineSet, Interval, interval, symmetric

SERIES_TERMS = 34
"""Terms of the Taylor series: T A is some 6 in units of the coordinates, and 6^35/35! is 2e-13."""

SYMBOL_NAMES = (
    "c_law", "zeta", "chi", "gain", "flow", "flow_error", "eta", "eta_law", "mean", "drift", "spring", "spool",
    "dead_time", "share",
)  # fmt: skip
F, Z, ZR, L, LR, X, V, BOX_VELOCITY = range(8)
"""Coordinates; all but the last are states within a sample."""


@dataclass(frozen=True)
class JacobianBounds:
    """Bounds of the quantities in the Jacobian, SI units; symbols as in the module's docstring."""

    c_law: Interval
    zeta: Interval
    chi: Interval
    flow: Interval
    """nu without leaks [1/s]."""
    flow_error: Interval
    """Part of a nu^ by u_nom - s [1/s]."""
    flow_deviation: float
    """Largest deviation of nu from its mean within a sample [1/s]."""
    flow_ratio: Interval
    """a nu^ over nu at the same opening."""
    leak: Interval
    eta: Interval
    eta_law: Interval
    """a eta^ [N/s/m]."""
    mean: Interval
    drift: Interval
    """Relative change of g over a sample."""
    spring: Interval
    spool: Interval
    """Natural frequency of the spool [rad/s]."""
    dead_time: Interval
    share: Interval
    """C_1."""
    c_deviation: float
    """Largest deviation of c from its mean within a sample [N/m]."""
    gain_ratio: Interval
    """a."""
    g: Interval
    """N/s/A."""


def jacobian_bounds(region: CertifiedRegion, tolerances: Mapping[str, Bounds], side: int) -> JacobianBounds:
    """Return the bounds over all states with the spool on one side (1, -1) and all benches within `tolerances`."""
    bench, law = region.bench, region.believed
    state = {name: interval(pair) for name, pair in region.states.items()}
    ratio = {name: interval(pair) for name, pair in tolerances.items()}
    area, alpha = bench["piston_area"], bench["area_ratio"]
    area_b = alpha * area
    supply, tank = ratio["supply_pressure"] * bench["supply_pressure"], bench["tank_pressure"]
    x, p_a, p_b, v = (state[name] for name in ("position", "pressure_a", "pressure_b", "velocity"))

    # volumes of the bench and of the law; the oil's stiffness over the law's, with x on one side of the division only
    dead_a, dead_b = (ratio[name] * bench[name] for name in ("dead_volume_a", "dead_volume_b"))
    room = bench["stroke"] - x
    volume_a, volume_b = dead_a + area * x, dead_b + area_b * room
    law_a, law_b = law["dead_volume_a"] + area * x, law["dead_volume_b"] + area_b * room
    bulge_a = 1.0 + (law["dead_volume_a"] - dead_a) / volume_a
    bulge_b = 1.0 + (law["dead_volume_b"] - dead_b) / volume_b
    modulus = ratio["bulk_modulus"] * (bench["bulk_modulus"] / law["bulk_modulus"])
    rho_a, rho_b, mu = modulus * bulge_a, modulus * bulge_b, bulge_b / bulge_a
    c_law_a, c_law_b = law["bulk_modulus"] * area**2 / law_a, law["bulk_modulus"] * area_b**2 / law_b
    sigma_law = 1.0 / (1.0 + alpha**2 * (law_a / law_b))
    stiffer = 1.0 + (1.0 - sigma_law) * (mu - 1.0)

    # pressure drops of the open edges: the bench's and the law's
    if side > 0:
        drop_a, drop_b = supply - p_a, p_b - tank
        known_a, known_b = law["supply_pressure"] - p_a, drop_b
        wrong_a, wrong_b = supply - law["supply_pressure"], interval(0.0)
    else:
        drop_a, drop_b = p_a - tank, supply - p_b
        known_a, known_b = drop_a, law["supply_pressure"] - p_b
        wrong_a, wrong_b = interval(0.0), supply - law["supply_pressure"]
    root_a, root_b = ((1.0 + w / k).sqrt() for w, k in ((wrong_a, known_a), (wrong_b, known_b)))
    phi = 1.0 / (1.0 + alpha * (known_b / known_a).sqrt() * (law_a / law_b))
    kappa = ratio["valve_gain"] * (bench["valve_gain"] / law["valve_gain"])
    weighted = _weighted(phi, root_a, root_b, sigma_law, mu)
    core = weighted * bulge_a * stiffer  # g over the law's, but for valve gain and bulk modulus
    # within a sample c moves by the velocity
    swept = SAMPLE_PERIOD * v.magnitude * max((area / volume_a).high, (area_b / volume_b).high)
    gain_ratio = kappa * modulus * core

    # nu, the pressures' effect on the flows, and a nu^ of the law, in which valve gain and modulus cancel
    opening, error = state["opening"], state["opening_error"].magnitude
    largest = max(opening.high, 0.0) if side > 0 else max(-opening.low, 0.0)
    stiff_a, stiff_b = (ratio["bulk_modulus"] * bench["bulk_modulus"] / volume for volume in (volume_a, volume_b))
    valve = ratio["valve_gain"] * bench["valve_gain"]
    slope_a, slope_b = stiff_a * valve / (2.0 * drop_a.sqrt()), stiff_b * valve / (2.0 * drop_b.sqrt())
    volumes = alpha**2 * (volume_a / volume_b)
    sigma = 1.0 / (1.0 + volumes)
    per_opening = slope_a * sigma + slope_b * (1.0 - sigma)
    part_a = 1.0 / (1.0 + slope_b / slope_a * volumes)
    flow_ratio = core * (root_b / bulge_b + part_a * (root_a / bulge_a - root_b / bulge_b))
    leak_a, leak_b = stiff_a * bench["leakage"], stiff_b * bench["leakage"]
    leak = leak_a * sigma + leak_b * (1.0 - sigma) + leak_a / alpha * (1.0 - sigma) + alpha * leak_b * sigma

    # eta, the position's effect, and the law's estimates of P_a', P_b': the bench's flow, wrong by its ratio, by
    # u_nom's share and by x'_box
    rate_a, rate_b = area * state["pressure_a_rate"], area_b * state["pressure_b_rate"]
    eta = area / volume_a * rate_a + area_b / volume_b * rate_b
    compensation, late = interval(region.velocity_compensation), state["velocity_error"]
    across = bench["leakage"] * (p_a - p_b)
    c_a, c_b, push_a, push_b = stiff_a * area**2, stiff_b * area_b**2, stiff_a * area, stiff_b * alpha * area
    g_a, g_b = push_a * valve * drop_a.sqrt(), push_b * valve * drop_b.sqrt()
    right_a, right_b = 1.0 / (kappa * rho_a * root_a), 1.0 / (kappa * rho_b * root_b)
    left_a, left_b = c_a * v * (right_a - compensation / rho_a), c_b * v * (right_b - compensation / rho_b)
    told_a = right_a * (rate_a + push_a * across + g_a * symmetric(error)) + left_a - compensation * c_law_a * late
    told_b = right_b * (rate_b - push_b * across + g_b * symmetric(error)) - left_b + compensation * c_law_b * late

    slope = state["gain_drift"]
    down, up = (math.expm1(SAMPLE_PERIOD * end) * (1.0 + 1e-9) for end in (slope.low, slope.high))
    drift = Interval(min(down, 0.0), max(up, 0.0))
    flow_deviation = per_opening.high * (
        0.5 * SAMPLE_PERIOD * state["opening_rate"].magnitude + drift.magnitude * largest
    )
    return JacobianBounds(
        c_law=c_law_a + c_law_b, zeta=rho_a * stiffer,
        chi=kappa * weighted * interval((1.0 - swept, 1.0 + swept)), gain_ratio=gain_ratio,
        flow=per_opening * Interval(0.0, largest), flow_deviation=flow_deviation, flow_ratio=flow_ratio,
        flow_error=flow_ratio * (per_opening * symmetric(error) + symmetric(flow_deviation)), leak=leak,
        eta=eta, eta_law=gain_ratio * (area / law_a * told_a + area_b / law_b * told_b),
        mean=0.5005 * drift,  # the mean of an exponential is within a thousandth of half its end
        drift=drift, spring=ratio["spring_stiffness"] * bench["spring_stiffness"],
        spool=ratio["spool_bandwidth"] * (2.0 * math.pi * bench["spool_bandwidth"]), dead_time=ratio["dead_time"],
        share=compensation, c_deviation=(c_a + c_b).high * swept, g=g_a + g_b,
    )  # fmt: skip


def _weighted(phi: Interval, root_a: Interval, root_b: Interval, sigma: Interval, mu: Interval) -> Interval:
    """(phi r_a + (1 - phi) r_b mu) / (sigma + (1 - sigma) mu): monotone in each, extremes are at ends."""
    ends = []
    for p, a, b, s, m in product(*((one.low, one.high) for one in (phi, root_a, root_b, sigma, mu))):
        above = interval(p) * a + (1.0 - interval(p)) * (interval(b) * m)
        ends.append(above / (interval(s) + (1.0 - interval(s)) * m))
    return Interval(min(one.low for one in ends), max(one.high for one in ends))


def affine_symbol(name: str, of: Interval) -> AffineSet:
    """Return an interval as a 1 x 1 affine set with its own symbol."""
    number = affine_radius(Interval(of.midpoint, of.midpoint))
    number.slopes[SYMBOL_NAMES.index(name), 0, 0] = of.radius
    return number


def affine_radius(of: Interval | float) -> AffineSet:
    """Return an interval as a 1 x 1 affine set without symbols, by its radius."""
    of = interval(of)
    number = zeros(1, 1)
    number.center[0, 0], number.radius[0, 0] = of.midpoint, of.radius if of.low < of.high else 0.0
    return number


def zeros(rows: int, columns: int) -> AffineSet:
    """Return the zero matrix as an affine set."""
    return AffineSet(np.zeros((rows, columns)), np.zeros((len(SYMBOL_NAMES), rows, columns)), np.zeros((rows, columns)))


def set_block(into: AffineSet, row: int, column: int, number: AffineSet) -> None:
    """Write a block into a larger affine set of matrices, at `row` and `column`."""
    rows, columns = number.center.shape
    at = slice(row, row + rows), slice(column, column + columns)
    into.center[at], into.radius[at] = number.center, number.radius
    into.slopes[:, at[0], at[1]] = number.slopes


DISTURBANCE_NAMES = ("friction", "current", "velocity", "overlap")
"""Disturbances by column of D."""


def enclose_closed_loop(
    region: CertifiedRegion, tolerances: Mapping[str, Bounds], side: int, gain: Interval
) -> AffineSet:
    """Return an enclosure of [F + G K, D], shape (n, n + 4), in scaled coordinates; D: effect of the disturbances."""
    n, bench, count = jacobian_bounds(region, tolerances, side), region.bench, region.coordinates
    wrong, scale, width = region.disturbances, np.array(region.scale), count + len(DISTURBANCE_NAMES)
    ways, unit = count - 8, scale[:7]
    every, within = range(width), range(7)
    one = affine_radius(1.0)
    chi, zeta, k, omega, flow = (
        affine_symbol(name, getattr(n, name)) for name in ("chi", "zeta", "spring", "spool", "flow")
    )
    c = affine_symbol("c_law", n.c_law) @ zeta
    grown, later = one + affine_symbol("mean", n.mean), one + affine_symbol("drift", n.drift)
    omega_c, mass = 2.0 * math.pi * bench["cell_bandwidth"], bench["moving_mass"]
    entries = {
        (F, F): (flow + affine_radius(n.leak)) * -1.0, (F, Z): grown,
        (F, X): affine_symbol("eta", n.eta) * -1.0, (F, V): c * -1.0,
        (Z, ZR): one, (ZR, Z): (omega @ omega) * -1.0, (ZR, ZR): omega * (-2.0 * bench["spool_damping"]),
        (L, LR): one, (LR, X): k * omega_c**2, (LR, L): one * -(omega_c**2),
        (LR, LR): one * (-2.0 * bench["cell_damping"] * omega_c),
        (X, V): one, (V, F): one * (1.0 / mass), (V, X): k * (-1.0 / mass),
        (V, V): one * (-bench["viscous_friction"] / mass),
    }  # fmt: skip
    # how far entries of the mean transition may be from their mean within a sample
    apart = {
        (F, F): n.flow_deviation,
        (F, Z): 0.51 * n.drift.magnitude,
        (F, X): 4.0 * n.eta.magnitude,
        (F, V): n.c_deviation,
    }
    rates, varies = zeros(7, 7), np.zeros((7, 7))
    for (row, column), entry in entries.items():
        factor = SAMPLE_PERIOD * unit[column] / unit[row]
        set_block(rates, row, column, entry * factor)
        varies[row, column] = apart.get((row, column), 0.0) * factor
    inputs = zeros(7, 3)  # the current, a force on the mass, an opening
    set_block(inputs, ZR, 0, omega @ omega * (SAMPLE_PERIOD * scale[Z] / unit[ZR]))
    set_block(inputs, V, 1, one * (SAMPLE_PERIOD / mass / unit[V]))
    set_block(inputs, F, 2, grown * (SAMPLE_PERIOD * scale[Z] / unit[F]))
    moved, pushed = enclose_transition(rates, varies, inputs, one, whole=True)

    # the law's current, as the opening that it will be, by the coordinates
    law = zeros(1, width)
    mid, apart_of_ratio = n.flow_ratio.midpoint, n.flow_error + symmetric(n.flow_ratio.radius * n.flow.high)
    set_block(law, 0, F, (flow * mid + affine_symbol("flow_error", apart_of_ratio)) * (scale[F] / scale[Z]))
    set_block(law, 0, L, chi @ zeta @ affine_symbol("gain", gain) * (-scale[L] / scale[Z]))
    set_block(law, 0, X, affine_symbol("eta_law", n.eta_law) * (scale[X] / scale[Z]))
    set_block(law, 0, BOX_VELOCITY, affine_symbol("share", n.share) @ chi @ c * (scale[BOX_VELOCITY] / scale[Z]))
    noise = n.gain_ratio * (gain.magnitude * wrong["force_noise"]) + (n.flow + n.flow_error.magnitude) * (
        2.0 * wrong["pressure_noise"] * bench["piston_area"]
    )
    set_block(law, 0, count + 1, affine_radius(noise.high / scale[Z]))

    # rows of the states: by themselves, by the current, by the disturbances
    by_current = pushed.submatrix(within, [0])
    if ways:
        late = affine_symbol("dead_time", ((ways - 1.0) * SAMPLE_PERIOD + SAMPLE_PERIOD - n.dead_time) / SAMPLE_PERIOD)
        fresh = enclose_transition(rates, varies, inputs, late, whole=False)[1].submatrix(within, [0])
        newest = law if ways < 2 else _unit_row(8 + ways - 2, width)
        driven = fresh @ newest + (by_current + fresh * -1.0) @ _unit_row(8 + ways - 1, width)
    else:
        driven = by_current @ law
    out, rows = zeros(count, width), zeros(count, width)
    set_block(out, 0, 0, moved)
    set_block(rows, 0, 0, driven)
    out = out + rows
    set_block(out, 0, count, pushed.submatrix(within, [1]) * wrong["friction"])
    set_block(out, 0, count + 3, pushed.submatrix(within, [2]) * (n.g.high * wrong["overlap"] / scale[Z]))

    # the box's velocity, from the change of x; then the coordinates in units of g, with g at the next sample
    memory, still, own = bench["velocity_memory"], zeros(1, width), zeros(1, width)
    set_block(still, 0, X, one * -1.0)
    shown = (out.submatrix([X], every) + still) * ((1.0 - memory) / SAMPLE_PERIOD * scale[X] / scale[BOX_VELOCITY])
    set_block(own, 0, BOX_VELOCITY, one * memory)
    set_block(own, 0, count + 2, one * (wrong["velocity_noise"] / scale[BOX_VELOCITY]))
    set_block(out, BOX_VELOCITY, 0, shown + own)
    for row in (Z, ZR):
        set_block(out, row, 0, later @ out.submatrix([row], every))
    for way in range(ways):
        set_block(out, 8 + way, 0, later @ (law if way == 0 else _unit_row(8 + way - 1, width)))
    return out


def _unit_row(column: int, width: int) -> AffineSet:
    row = zeros(1, width)
    row.center[0, column] = 1.0
    return row


def enclose_transition(
    rates: AffineSet, deviation: FloatArray, inputs: AffineSet, reach: AffineSet, whole: bool
) -> tuple[AffineSet, AffineSet]:
    """Return enclosures of the transition matrix and of the response to held inputs over the last `reach` of a sample.

    The series of time-ordered products of rates A(t): its n-th term is the n-fold product of their mean, A, and terms
    with one and more deviations E(t) from it, |E| <= `deviation`. All are times T. Over a `whole` sample E has the mean
    0 and a slope of at most 2 |E|/T, so that a term with one E counts (n - 1)/(n + 1) of its size:
    int E t^(n-1) dt <= (2/T) int |t^n - t T^(n-1)|/n dt = (n - 1)/(n + 1) T^n/n.
    """
    states, count = len(rates.center), len(rates.center) + inputs.center.shape[1]
    set_of = zeros(count, count)
    set_block(set_of, 0, 0, rates)
    set_block(set_of, 0, states, inputs)
    by_reach = zeros(count, count)
    for place in range(count):
        set_block(by_reach, place, place, reach)
    set_of = set_of @ by_reach
    size, varies = set_of.magnitude, np.zeros((count, count))
    varies[:states, :states] = deviation * reach.magnitude[0, 0]
    total, term = zeros(count, count), zeros(count, count)
    total.center[:] = term.center[:] = np.eye(count)
    plain: FloatArray = np.eye(count)
    every, single = plain, np.zeros_like(plain)
    for order in range(1, SERIES_TERMS + 1):
        term = (term @ set_of) * (1.0 / order)
        single = (single @ size + plain @ varies) / order
        plain, every = plain @ size / order, every @ (size + varies) / order
        total = total + term
        counted = (order - 1.0) / (order + 1.0) if whole else 1.0
        total.radius[:] += (counted * single + np.maximum(every - plain - single, 0.0)) * (1.0 + 1e-9) + 1e-15 * every
    norm = float((size + varies).sum(axis=1).max())
    total.radius[:] += (
        norm ** (SERIES_TERMS + 1) / math.factorial(SERIES_TERMS + 1) / (1.0 - norm / (SERIES_TERMS + 2)) * (1.0 + 1e-9)
    )
    return total.submatrix(range(states), range(states)), total.submatrix(range(states), range(states, count))
