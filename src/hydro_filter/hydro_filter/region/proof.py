# SPDX-License-Identifier: Apache-2.0
"""Proof of a certified region: a linear matrix inequality at the vertices of the sample's affine set.

::

    H = [F + G K, D]  in  C + sum_i s_i G_i + E          |s_i| <= 1, |E| <= R

    H' M(K_p+) H  <=  diag( exp(-2 lambda T) M(K_p), (1 - exp(-2 lambda T)) W )

The left side is convex in H, so that it holds within the set if it holds at the vertices with room for R. Its first
block is the contraction; all of it says that disturbances w with w'Ww <= 1 do not leave v'Mv <= 1, and the tube is the
largest f_l within. M is interpolated linearly, so that both sides are affine in K_p and K_p+ at a given H. The norm
is from LAPACK's eigenvalues, with `ROUNDING_ALLOWANCE` and a bound of the products' rounding to spare.
"""

from __future__ import annotations

import math
from itertools import pairwise, product

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.region.certified_region import CertifiedRegion, ToleranceCell
from hydro_filter.region.enclosure import enclose_closed_loop
from hydro_filter.region.interval import EPS, AffineSet, Interval

SLOPE_MIN = 1e-7
"""Sum of a symbol's slopes below which the symbol becomes radius."""
ROUNDING_ALLOWANCE = 1e-8
"""Allowance for rounding outside of interval arithmetic: 1e-15 times the metric's condition number."""
PROMOTED_ENTRIES = 2
"""Entries of the radius that become symbols: the largest, by which f_h follows the spool."""


def interpolate_metric(cell: ToleranceCell, gain: float) -> FloatArray:
    """Return M(K_p), interpolated linearly within the table, constant beyond its ends."""
    place = float(np.clip(np.interp(gain, cell.gains, np.arange(len(cell.gains))), 0, len(cell.gains) - 1))
    low = min(int(place), max(len(cell.gains) - 2, 0))
    share = place - low
    return (1.0 - share) * cell.matrices[low] + (share * cell.matrices[low + 1] if share else 0.0)


def reduce_symbols(sample: AffineSet) -> tuple[AffineSet, FloatArray]:
    """Return the set with few symbols, and the symbols' vertices, shape (2^symbols, symbols).

    Small symbols become radius; the `PROMOTED_ENTRIES` largest entries of the radius become symbols.
    """
    kept = np.abs(sample.slopes).sum(axis=(1, 2)) > SLOPE_MIN
    radius = sample.radius + np.abs(sample.slopes[~kept]).sum(axis=0)
    count = len(radius)
    largest = np.argsort(radius[:, :count], axis=None)[::-1][:PROMOTED_ENTRIES]
    promoted = np.zeros((PROMOTED_ENTRIES, *radius.shape))
    for number, place in enumerate(largest):
        row, column = divmod(int(place), count)
        promoted[number, row, column], radius[row, column] = radius[row, column], 0.0
    slopes = np.concatenate((sample.slopes[kept], promoted))
    return AffineSet(sample.center, slopes, radius), np.array(list(product((-1.0, 1.0), repeat=len(slopes))))


def decay_margin(
    region: CertifiedRegion, pair: tuple[FloatArray, FloatArray], sample: AffineSet, signs: FloatArray
) -> FloatArray:
    """Return the margin 1 - ||M+^1/2 (H + E) D^-1/2|| at every vertex, shape (vertices,); positive: it contracts."""
    before, after = pair
    n, decay, used = len(before), region.decay, region.directions
    bound = np.zeros((n + len(used), n + len(used)))
    bound[:n, :n] = decay * (1.0 - 4.0 * EPS) * before
    bound[n:, n:] = np.diag([(1.0 - decay) * region.weights[i] for i in used]) * (1.0 - 1e-9)
    columns = [*range(n), *(n + i for i in used)]
    left, right = np.linalg.cholesky(after).T, np.linalg.inv(np.linalg.cholesky(bound).T)
    center, slopes = sample.center[:, columns] @ right, sample.slopes[:, :, columns] @ right
    lost = float(np.linalg.norm(np.abs(left) @ sample.radius[:, columns] @ np.abs(right)))
    size = sample.magnitude[:, columns]
    reach, weight = size @ np.abs(right), np.abs(after) + np.abs(left.T) @ np.abs(left)
    squares = np.abs(right.T) @ np.abs(bound) @ np.abs(right), reach.T @ weight @ reach
    rounding = 100.0 * EPS * float(sum(np.linalg.norm(one) for one in squares))
    whole = left @ (center + np.tensordot(signs, slopes, 1))
    largest = np.linalg.eigvalsh(whole.transpose(0, 2, 1) @ whole)[:, -1]
    return 1.0 - lost - rounding - ROUNDING_ALLOWANCE - np.sqrt(largest + rounding)


def prove_cell(region: CertifiedRegion, cell: ToleranceCell, subdivisions: int = 1) -> float:
    """Return the smallest `decay_margin` over a cell, each segment in `subdivisions` parts; positive: proved."""
    least, reach = math.inf, region.gain_rate * SAMPLE_PERIOD
    for segment in pairwise(cell.gains):
        for low, high in pairwise(np.linspace(*segment, subdivisions + 1).tolist()):
            gain, first, last = Interval(low, high), interpolate_metric(cell, low), interpolate_metric(cell, high)
            pairs = [(first, first), (last, last)]  # vertices of (M(K_p), M(K_p+))
            if reach != 0.0:  # by this segment's slope, and where the next one begins by its own
                step, ends = (last - first) * (reach / (high - low)), ((first, low), (last, high))
                pairs = [
                    (m, after) for (m, k), sign in product(ends, (1.0, -1.0))
                    for after in (m + sign * step, interpolate_metric(cell, k + sign * reach))
                ]  # fmt: skip
            for side in (1, -1):
                sample, signs = reduce_symbols(enclose_closed_loop(region, cell.tolerances, side, gain))
                least = min(least, *(float(decay_margin(region, pair, sample, signs).min()) for pair in pairs))
    return least
