# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels of the adaptive compensation: update of fit and coefficients by the samples of a policy step.

Equations, arrays and settings are those of `estimator`.
"""

from __future__ import annotations

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP
from hydro_policy.compensation.estimator import (
    FILTER_ORDER,
    FILTER_SETTLING_TIME,
    INITIAL_COEFFICIENTS,
    LEVEL,
    NOISE_SHARE,
    PREDICTION_HORIZON,
    STEP_PERIOD,
    THIRD_DIFFERENCE_GAIN,
    VALVE_TERMS,
)
from hydro_sim.jit import njit


@njit
def update(settings, constants, memory, samples, active, frozen, counted, coefficients):
    """Update fits and coefficients in place by a policy step; `samples`: f_c, f, f_r', f_r in SI, shape (n, 4, 10)."""
    signals = np.empty((memory.last.shape[1], SAMPLES_PER_STEP))
    transition, inputs, before = constants.transition, constants.inputs, np.empty(FILTER_ORDER)
    for i in range(len(samples)):
        counted[i] = active[i] and np.isfinite(samples[i]).all() and _plausible(settings[0], memory, samples, i)
        if counted[i]:
            signals[:2] = samples[i, :2]
            for k in range(SAMPLES_PER_STEP):
                _terms(settings[0], samples[i, 3, k], samples[i, 2, k], signals[2:, k])
                _play(constants.plays, memory.within[i], samples[i, 2, k], SAMPLE_PERIOD, signals[6:, k])
            for channel in range(len(signals)):  # the state-variable filter
                state, now = memory.states[i, channel], signals[channel]
                if memory.steps[i] == 0:
                    state[:], memory.last[i, channel] = 0.0, now[0]
                    state[0] = now[0]
                before[:] = state
                for j in range(FILTER_ORDER):
                    total = inputs[0, j] * memory.last[i, channel]
                    for k in range(FILTER_ORDER):
                        total += transition[j, k] * before[k]
                    for k in range(SAMPLES_PER_STEP):
                        total += inputs[k + 1, j] * now[k]
                    state[j] = total
                memory.last[i, channel] = now[-1]
            share = max(STEP_PERIOD / settings[0].memory, 1.0 / (memory.steps[i] + 1.0))
            memory.noise[i] += share * (_noise(samples[i, 1]) - memory.noise[i])
            memory.steps[i] += 1
            if memory.steps[i] * STEP_PERIOD > FILTER_SETTLING_TIME and not frozen[i]:
                _learn(settings[0], constants, memory, i)
        else:
            memory.steps[i], memory.within[i] = 0, 0.0
        _command(settings[0], constants, memory, samples[i, 2], samples[i, 3, -1], coefficients[i], i)


@njit
def _terms(settings, reference, rate, into):
    """Write the regressors of b_0 to b_3 into `into`, from f_r [N] and f_r' [N/s]."""
    into[0], into[1] = np.tanh(rate / settings.reversal), abs(rate)
    into[2], into[3] = reference * rate, reference * abs(rate)


@njit
def _play(plays, within, rate, seconds, into):
    """Write the plays' rates p_j' [N/s] into `into`, for f_r' = `rate` over `seconds`; updates `within` [N]."""
    for j in range(len(plays)):
        free = within[j] + rate * seconds
        within[j] = min(max(free, -plays[j]), plays[j])
        into[j] = (free - within[j]) / seconds


@njit
def _command(settings, constants, memory, rate, reference, coefficients, i):
    """Compute the coefficients for the next policy step; a_3 holds where f_r' is missing."""
    found, added = memory.estimate[i], np.empty(len(INITIAL_COEFFICIENTS) - VALVE_TERMS)
    ahead = rate[-1] + (rate[-1] - rate[0]) * PREDICTION_HORIZON / (STEP_PERIOD - SAMPLE_PERIOD)
    _terms(settings, reference + PREDICTION_HORIZON * ahead, ahead, added)
    within = memory.within[i].copy()
    _play(constants.plays, within, 0.5 * (rate[-1] + ahead), PREDICTION_HORIZON, added[4:])
    _play(constants.plays, within, ahead, SAMPLE_PERIOD, added[4:])
    level = found[LEVEL] + np.sum(found[VALVE_TERMS:] * added)
    for j in range(VALVE_TERMS):
        if j != LEVEL:
            coefficients[j] = found[j]
        elif np.isfinite(level):
            coefficients[j] = min(max(level, constants.lower[j]), constants.upper[j])


@njit
def _plausible(settings, memory, signals, i):
    """Whether the load cell neither jumps nor is stuck, and the load is in contact."""
    commanded, measured = signals[i, 0], signals[i, 1]
    before = memory.last[i, 1] if memory.steps[i] > 0 else measured[0]
    scale, least = settings.force_scale, settings.no_load * settings.force_scale
    stuck, loose, last = np.ptp(commanded) > 1e-3 * scale, True, before
    for k in range(SAMPLES_PER_STEP):
        if abs(measured[k] - last) > settings.jump * scale:
            return False
        last = measured[k]
        stuck = stuck and last == before
        loose = loose and abs(last) < least and abs(commanded[k]) > 10.0 * least
    return not (stuck or loose)


@njit
def _noise(measured):
    """Variance of white noise [N^2] in the force of a policy step, from its third differences."""
    total = 0.0
    for k in range(3, SAMPLES_PER_STEP):
        total += (measured[k] - 3.0 * (measured[k - 1] - measured[k - 2]) - measured[k - 3]) ** 2
    return total / (SAMPLES_PER_STEP - 3) / THIRD_DIFFERENCE_GAIN


@njit
def _learn(settings, constants, memory, i):
    """Update fit and coefficients."""
    share, states, found = STEP_PERIOD / settings.memory, memory.states[i], memory.estimate[i]
    phi = np.ones(len(INITIAL_COEFFICIENTS))
    phi[:LEVEL] = constants.regressors[:LEVEL] @ states[1]
    phi[LEVEL + 1] = np.sum(constants.regressors[LEVEL] * states[1])
    phi[VALVE_TERMS:] = states[2:, 0] / constants.scale[VALVE_TERMS:] / settings.force_scale
    target = states[0, 0] / settings.force_scale
    memory.excitation[i] += share * (2.0 * phi[1] ** 2 - memory.excitation[i])
    excitation = memory.excitation[i]
    missed = target - np.sum(phi * found * constants.scale)
    ratio = min(1.0 + (missed / settings.residual_threshold) ** 2, settings.forgetting_ratio_max)
    kept = 1.0 - share * ratio * min(excitation / settings.good_excitation, 1.0)
    memory.matrix[i] = kept * memory.matrix[i] + STEP_PERIOD * np.outer(phi, phi)
    memory.vector[i] = kept * memory.vector[i] + STEP_PERIOD * phi * target
    memory.noise_sum[i] = kept * memory.noise_sum[i] + STEP_PERIOD * memory.noise[i]
    if excitation >= settings.least_excitation:
        matrix, off = memory.matrix[i] + np.diag(constants.weights), memory.noise_sum[i]
        places = (0, 1, 2, LEVEL + 1)
        for j in range(len(places)):
            off = min(off, memory.matrix[i, places[j], places[j]] / constants.noise[j, j])
        for j in range(len(places)):
            for k in range(len(places)):
                matrix[places[j], places[k]] -= NOISE_SHARE * off * constants.noise[j, k]
        fit = (
            np.linalg.solve(matrix, memory.vector[i] + constants.weights * INITIAL_COEFFICIENTS * constants.scale)
            / constants.scale
        )
        found[:] = np.minimum(np.maximum(fit, constants.lower), constants.upper)
    else:
        found[0] += (1.0 - found[0]) * STEP_PERIOD / settings.settling
        found[LEVEL] -= found[LEVEL] * STEP_PERIOD / settings.settling
