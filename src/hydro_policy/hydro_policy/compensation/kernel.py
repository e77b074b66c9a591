# SPDX-License-Identifier: Apache-2.0
"""Kernels of the adaptive compensation, compiled: samples of a policy step in, fit and coefficients out.

The equations are those of `estimator`, whose arrays and settings come in.
"""

from __future__ import annotations

import numpy as np

from hydro_core.signals import SAMPLES_PER_STEP
from hydro_policy.compensation.estimator import NEUTRAL_TERMS, SETTLED, STEP
from hydro_sim.jit import njit


@njit
def take(settings, constants, memory, signals, active, frozen, counted):
    """Take the four signals of a policy step, shape (n, 4, 10); learn on the benches that count."""
    for i in range(len(signals)):
        counted[i] = active[i] and np.isfinite(signals[i]).all() and _plausible(settings[0], memory, signals, i)
        if not counted[i]:
            memory.steps[i] = 0
            continue
        for channel in range(4):
            state, now = memory.states[i, channel], signals[i, channel]
            if memory.steps[i] == 0:
                state[:], memory.last[i, channel] = 0.0, now[0]
                state[0] = now[0]
            state[:] = constants.transition @ state + constants.inputs[0] * memory.last[i, channel]
            for k in range(SAMPLES_PER_STEP):
                state += constants.inputs[k + 1] * now[k]
            memory.last[i, channel] = now[-1]
        memory.steps[i] += 1
        if memory.steps[i] * STEP > SETTLED and not frozen[i]:
            _learn(settings[0], constants, memory, i)


@njit
def _plausible(settings, memory, signals, i):
    """Whether the load cell shows what a bench can do."""
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
def _learn(settings, constants, memory, i):
    """Update fit and coefficients."""
    share, states, found = STEP / settings.memory, memory.states[i], memory.found[i]
    phi = np.ones(len(NEUTRAL_TERMS))
    phi[:3] = constants.regressors @ states[1]
    phi[4:] = states[2:, 0] / constants.scale[4:] / settings.force_scale
    target = states[0, 0] / settings.force_scale
    memory.excitation[i] += share * (2.0 * phi[1] ** 2 - memory.excitation[i])
    excitation = memory.excitation[i]
    missed = target - np.sum(phi * found * constants.scale)
    haste = min(1.0 + (missed / settings.surprise) ** 2, settings.haste)
    kept = 1.0 - share * haste * min(excitation / settings.good_excitation, 1.0)
    memory.matrix[i] = kept * memory.matrix[i] + STEP * np.outer(phi, phi)
    memory.vector[i] = kept * memory.vector[i] + STEP * phi * target
    if excitation >= settings.least_excitation:
        matrix = memory.matrix[i] + np.diag(constants.weights)
        fit = np.linalg.solve(matrix, memory.vector[i] + constants.weights * NEUTRAL_TERMS) / constants.scale
        fit = np.minimum(np.maximum(fit, constants.least), constants.most)
    else:
        fit = found.copy()
        fit[0], fit[3] = 1.0, 0.0
    found += (fit - found) * STEP / settings.settling
