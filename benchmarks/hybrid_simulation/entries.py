# SPDX-License-Identifier: Apache-2.0
"""Entries: what commands the actuator, from the target x_n1 and the measured displacement x_m alone.

All but PI-P command a series of the target's derivatives, which are backward differences at 4096 Hz::

    u = a_0 x_n + a_1 x_n' + a_2 x_n'' + a_3 x_n'''

none                   nothing is adapted, a = (1, 0, 0, 0)
pi_p                   the organisers' sample: lead on the target, PI on the measured displacement
ats                    adaptive time series (Chae, Kazemibidokhti, Ricles 2013): sliding least squares of the filtered
                       u on the filtered x_m and its derivatives, with the limits and rates of its file
ats_fast               the same, rates times ten, as in the paper
amb                    adaptive model-based (Galmez, Fermandois), gains found by its authors' particle swarm
least_squares_3, _4    sliding least squares on three or four terms, without limits
compensated            our law as it ships (`hydro_policy.compensation`), with f = `FORCE_PER_METRE` x
compensated_residual   the same with the shipped learned residual
oracle                 knows actuator and specimen: the series of the plant's inverse, and what f_h takes beside it
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.signal import butter

from benchmarks.hybrid_simulation.motions import SAMPLING, STEP
from benchmarks.hybrid_simulation.plant import Actuator, Specimen, hysteresis_rate, transfer_function
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import NEUTRAL_COEFFICIENTS, SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_sim.jit import njit

ENTRIES = (
    "none", "pi_p", "ats", "ats_fast", "amb", "least_squares_3", "least_squares_4", "compensated",
    "compensated_residual", "oracle",
)  # fmt: skip
FIXED, PI_P, LEAST_SQUARES, GRADIENT, BOX, ORACLE = range(6)
"""Kinds of entries."""
TERMS = 4
"""Of the series."""
SATURATION, QUANTUM = 3.8, 2.0**-18
"""Of the converters [m]."""
PROPORTIONAL, INTEGRAL = 2.0, 95.0
"""Gains of the sample controller [-], [1/s]."""
LEAD_ZERO, LEAD_POLE = 50.83163360273612, 8570.397339444286
"""Of its lead (LEAD_ZERO s + LEAD_POLE) / (s + LEAD_POLE) [-], [1/s]."""
EVERY = 16
"""Samples between two fits."""
CUT_OFF = 20.0
"""Hz, of the low-pass of measurement and command."""
VISIBLE = 1e-4
"""m, displacement from which on the textbook's least squares fit: sixty standard deviations of the filtered noise."""
SCALE = (2.0 * math.pi * 3.0) ** np.arange(TERMS)
"""Of the derivatives of a displacement in a fit [1/s^i]: those of a sine of 3 Hz have one size."""

BOX_EVERY = 4
"""Samples at 4096 Hz between two of our box."""
TEMPO = BOX_EVERY * STEP / SAMPLE_PERIOD
"""Seconds of the benchmark in a second of the box, whose sample is 1 ms."""
FORCE_PER_METRE = 1e5
"""N/m, force that our law is given for a displacement: 100 N for 1 mm."""
ACTS = 5
"""Sample of a policy step from which on the coefficients act that the last one chose, as in the graph."""


class Series(NamedTuple):
    """A series of the target's derivatives, and how its coefficients are adapted."""

    coefficients: FloatArray
    """a_0 to a_3 [s^i], shape (4,)."""
    least: FloatArray
    most: FloatArray
    """Bounds of the coefficients [s^i], shape (4,)."""
    rate: FloatArray
    """Fastest change of a fitted coefficient [s^i / s], shape (4,)."""
    gains: FloatArray
    """Of the gradient, shape (4,)."""
    terms: int
    """Coefficients that are fitted."""
    threshold: float
    """m, largest measured displacement of the window below which nothing is fitted."""
    targets: FloatArray
    """Last four targets [m], the newest first, shape (4,)."""
    filtered: FloatArray
    """Last four filtered measurements [m], the newest first, shape (4,)."""
    sections: FloatArray
    """Low-pass of command and measurement, scipy's sections of second order, shape (n, 6)."""
    memory: FloatArray
    """Of both filters, shape (2, n, 2)."""
    rows: FloatArray
    """Window of derivatives over `SCALE`, and command, shape (m, 5)."""
    sums: FloatArray
    """Normal equations over the window, shape (4, 5)."""


class Box(NamedTuple):
    """Our box's reference, f_c: see firmware/hydro/force_law.h."""

    wanted: FloatArray
    """a_0 to a_4 that were commanded, shape (5,)."""
    acting: FloatArray
    """a_0 to a_4 on their way there, shape (5,)."""
    rate: FloatArray
    """Fastest change of each per s, shape (5,)."""
    limit: float
    """Largest |f_c| [N]."""
    memory: FloatArray
    """The command [m], shape (1,)."""
    samples: FloatArray
    """f_c, f [N], f_r' [N/s], f_r [N] of the policy step, shape (4, 10)."""


class Oracle(NamedTuple):
    """The plant as the oracle knows it."""

    actuator: Actuator
    specimen: Specimen
    flows: FloatArray
    """q that f_h takes [N/s], at this sample and the two before, the newest first, shape (3,)."""
    hysteresis: FloatArray
    """f_h along the target [N], shape (1,)."""


class Entry(NamedTuple):
    """An entry and what it remembers."""

    kind: int
    series: Series
    pi: FloatArray
    """Last target, lead, error [m] and integral [m], shape (4,)."""
    box: Box
    oracle: Oracle


def entry(name: str, actuator: Actuator, specimen: Specimen) -> Entry:
    """Return one of `ENTRIES` at the beginning of a run; the plant is for the oracle."""
    kind, series = FIXED, _series((1.0, 0.0, 0.0, 0.0))
    if name == "pi_p":
        kind = PI_P
    elif name in ("ats", "ats_fast"):  # numbers: OpenFresco RTActualTestModels
        kind, times = LEAST_SQUARES, 10.0 if name == "ats_fast" else 1.0
        series = _series(
            (1.0, 0.02, 2e-4, 0.0), order=6, terms=3, window=1.0, threshold=2.54e-4, least=(0.9, 0.0, 0.0, 0.0),
            most=(1.1, 0.06, 3.2e-3, 0.0), rate=(0.2 * times, 5e-3 * times, 1e-4 * times, 0.0),
        )  # fmt: skip
    elif name in ("least_squares_3", "least_squares_4"):
        kind = LEAST_SQUARES
        series = _series((1.0, 0.02, 2e-4, 0.0), terms=int(name[-1]), window=2.0, threshold=VISIBLE)
    elif name == "amb":  # numbers: RobustAMBCvRTHS, AMB_L_1_vRTHS.m
        kind = GRADIENT
        series = _series(
            (1.0, 0.0198591597, 8.44014286e-05, 1.98591596e-07), least=(0.0, 0.0, 0.0, 0.0),
            gains=(10.0**8.4, 10.0**6.2, 10.0**2.1, 10.0**0.8),
        )  # fmt: skip
    elif name in ("compensated", "compensated_residual"):
        kind = BOX
    elif name == "oracle":
        kind = ORACLE
        elastic = specimen._replace(stiffness=specimen.after_yield * specimen.stiffness)
        numerator, denominator = transfer_function(actuator, elastic)
        series = _series(_held(denominator[: -TERMS - 1 : -1] / numerator))
    law, samples = BoxLaw(), np.zeros((4, SAMPLES_PER_STEP))
    neutral = np.array(NEUTRAL_COEFFICIENTS), np.array(NEUTRAL_COEFFICIENTS)
    box = Box(*neutral, np.array(law.coefficient_rate), law.reference_max, np.zeros(1), samples)
    oracle = Oracle(actuator, specimen, np.zeros(3), np.zeros(1))
    return Entry(kind, series, np.zeros(4), box, oracle)


def _held(derivatives: FloatArray) -> tuple[float, ...]:
    """Coefficients on backward differences for those on derivatives, of a command that is held for a sample."""
    s = Polynomial((0.0, 1.0, STEP / 2.0, STEP**2 / 3.0))  # of the difference: -ln(1 - STEP d) / STEP
    hold = Polynomial((1.0, STEP / 2.0, 3.0 / 8.0 * STEP**2, 5.0 / 16.0 * STEP**3))  # exp(s STEP / 2)
    found = hold * Polynomial(derivatives)(s)
    return tuple(found.coef[:TERMS].tolist())


def _series(
    begin: tuple[float, ...], *, order: int = 4, terms: int = 0, window: float = 0.0, threshold: float = 0.0,
    least: tuple[float, ...] = (-math.inf,) * TERMS, most: tuple[float, ...] = (math.inf,) * TERMS,
    rate: tuple[float, ...] = (math.inf,) * TERMS, gains: tuple[float, ...] = (0.0,) * TERMS,
) -> Series:  # fmt: skip
    sections = butter(order, CUT_OFF, fs=SAMPLING, output="sos")
    rows = np.zeros((max(round(window * SAMPLING / EVERY), 1), TERMS + 1))
    return Series(
        np.array(begin), np.array(least), np.array(most), np.array(rate), np.array(gains), terms, threshold,
        np.zeros(TERMS), np.zeros(TERMS), sections, np.zeros((2, len(sections), 2)), rows,
        np.zeros((TERMS, TERMS + 1)),
    )  # fmt: skip


@njit
def command(entry, k, target, measured):
    """Return the command [m] of sample k, from the target and the measured displacement [m]."""
    series = entry.series
    _push(series.targets, target)
    if entry.kind == PI_P:
        return _pi_p(entry.pi, target, measured)
    derivatives = np.empty(TERMS)
    _differences(series.targets, derivatives)
    if entry.kind == BOX:
        if k % BOX_EVERY == 0:
            _box(entry.box, k // BOX_EVERY, derivatives, converted(measured))
        return entry.box.memory[0]
    u = 0.0
    for i in range(TERMS):
        u += series.coefficients[i] * derivatives[i]
    if entry.kind == ORACLE:
        u += _known(entry.oracle, derivatives[1])
    elif entry.kind != FIXED:
        filtered = _low_pass(series.sections, series.memory[0], u)
        _push(series.filtered, _low_pass(series.sections, series.memory[1], converted(measured)))
        _differences(series.filtered, derivatives)
        if entry.kind == GRADIENT:
            _descend(series, derivatives, filtered)
        elif k % EVERY == 0:
            _fit(series, k // EVERY, derivatives, filtered)
    return converted(u)


@njit
def _known(oracle, velocity):
    """Command [m] that the yielding spring takes at this velocity of the target [m/s]: its part of the inverse."""
    actuator, q = oracle.actuator, oracle.flows
    rate = hysteresis_rate(oracle.specimen, oracle.hysteresis[0], velocity)
    oracle.hysteresis[0] += STEP * rate
    _push(q, rate + actuator.a3 * oracle.hysteresis[0])
    second = (q[0] - 2.0 * q[1] + q[2]) / STEP**2
    first = (q[0] - q[1]) / STEP + 1.5 * STEP * second  # in the middle of the sample for which the command is held
    valve = actuator.beta2 * (q[0] + STEP * first) + actuator.beta1 * first + second
    return valve / (actuator.a1_beta0 * actuator.gain)


@njit
def converted(value):
    """Signal behind a converter of 18 bit."""
    return np.round(min(max(value, -SATURATION), SATURATION) / QUANTUM) * QUANTUM


@njit
def _push(values, value):
    for i in range(len(values) - 1, 0, -1):
        values[i] = values[i - 1]
    values[0] = value


@njit
def _differences(x, into):
    """x and its first three derivatives, from the last four samples."""
    into[0] = x[0]
    into[1] = (x[0] - x[1]) / STEP
    into[2] = (x[0] - 2.0 * x[1] + x[2]) / STEP**2
    into[3] = (x[0] - 3.0 * x[1] + 3.0 * x[2] - x[3]) / STEP**3


@njit
def _low_pass(sections, memory, value):
    for i in range(len(sections)):
        s, state = sections[i], memory[i]
        out = s[0] * value + state[0]
        state[0] = s[1] * value - s[4] * out + state[1]
        state[1] = s[2] * value - s[5] * out
        value = out
    return value


@njit
def _pi_p(memory, target, measured):
    """Lead and PI by Tustin's rule, converters around each."""
    c = 2.0 / STEP
    target = converted(target)
    zero, pole = LEAD_ZERO * c, LEAD_POLE
    lead = ((zero + pole) * target + (pole - zero) * memory[0] - (pole - c) * memory[1]) / (c + pole)
    memory[0], memory[1] = target, lead
    error = converted(converted(lead) - measured)
    memory[3] += INTEGRAL / c * (error + memory[2])
    memory[2] = error
    return converted(PROPORTIONAL * error + memory[3])


@njit
def _descend(series, derivatives, command):
    """Gradient of the squared error of the command that the measurement tells."""
    error, norm = command, 1.0
    for i in range(TERMS):
        error -= series.coefficients[i] * derivatives[i]
        norm += derivatives[i] ** 2
    for i in range(TERMS):
        change = STEP * series.gains[i] * error * derivatives[i] / norm
        series.coefficients[i] = min(max(series.coefficients[i] + change, series.least[i]), series.most[i])


@njit
def _fit(series, number, derivatives, command):
    """Least squares of the command on the measurement's derivatives, over a sliding window."""
    count, n, sums = len(series.rows), series.terms, series.sums
    row = series.rows[number % count]
    _add(sums, row, n, -1.0)
    for i in range(n):
        row[i] = derivatives[i] / SCALE[i]
    row[TERMS] = command
    _add(sums, row, n, 1.0)
    largest = 0.0
    for i in range(count):
        largest = max(largest, abs(series.rows[i, 0]))
    if largest < series.threshold:
        return
    fit = _solved(sums, n)
    for i in range(n):
        step, a = series.rate[i] * EVERY * STEP, series.coefficients[i]
        bounded = min(max(fit[i] / SCALE[i], series.least[i]), series.most[i])
        series.coefficients[i] = a + min(max(bounded - a, -step), step)


@njit
def _add(sums, row, terms, sign):
    for i in range(terms):
        for j in range(terms):
            sums[i, j] += sign * row[i] * row[j]
        sums[i, TERMS] += sign * row[i] * row[TERMS]


@njit
def _solved(sums, n):
    """Solution of n normal equations, by Gauss' elimination: their matrix is positive definite."""
    matrix, solution = sums.copy(), np.zeros(TERMS)
    for k in range(n):
        for i in range(k + 1, n):
            ratio = matrix[i, k] / matrix[k, k]
            for j in range(k, n):
                matrix[i, j] -= ratio * matrix[k, j]
            matrix[i, TERMS] -= ratio * matrix[k, TERMS]
    for i in range(n - 1, -1, -1):
        total = matrix[i, TERMS]
        for j in range(i + 1, n):
            total -= matrix[i, j] * solution[j]
        solution[i] = total / matrix[i, i]
    return solution


@njit
def _box(box, number, derivatives, measured):
    """f_c of a sample of the box, as hydro_compensate of firmware/hydro/force_law.h makes it of f_r."""
    x, first, second, third = derivatives
    first += 0.5 * STEP * second + STEP**2 / 3.0 * third  # a box has exact ones: those of the present sample
    second += STEP * third
    value, rate = FORCE_PER_METRE * x, FORCE_PER_METRE * first * TEMPO
    sample = number % SAMPLES_PER_STEP
    total = 0.0
    for i, term in enumerate(
        (value, rate, FORCE_PER_METRE * second * TEMPO**2, 1.0, FORCE_PER_METRE * third * TEMPO**3)
    ):
        step = box.rate[i] * SAMPLE_PERIOD
        box.acting[i] += min(max(box.wanted[i] - box.acting[i], -step), step)
        total += box.acting[i] * term
    commanded = min(max(total, -box.limit), box.limit)
    box.memory[0] = converted(commanded / FORCE_PER_METRE)
    box.samples[0, sample], box.samples[1, sample] = commanded, FORCE_PER_METRE * measured
    box.samples[2, sample], box.samples[3, sample] = rate, value
