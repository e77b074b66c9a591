# SPDX-License-Identifier: Apache-2.0
"""Adaptive time-series compensation: coefficients of the compensated reference from the measured force.

The compensated law follows f_c = a_0 f_r + a_1 f_r' + a_2 f_r'' + a_3 + a_4 f_r''' in place of f_r. At the reference's
frequencies the closed loop from f_c to the measured force f is nearly the inverse of such a polynomial

    f_c = a_0 f + a_1 f' + a_2 f'' + a_3 + a_4 f'''

so the coefficients a of a least-squares fit of the applied f_c to [f, f', f'', 1, f'''] make f follow f_r on any bench.
Source: Chae, Kazemibidokhti, Ricles 2013, Earthquake Engng Struct. Dyn. 42(11), 1697. Seven further terms are

    b_0 tanh(f_r' / r)           valve overlap: a step of the current at a reversal of the force
    b_1 |f_r'|                   dependence of a_1 on the direction: an asymmetric valve
    b_2 f_r f_r', b_3 f_r |f_r'| dependence of a_1 on the force: chamber volumes, and the valve's gain, proportional to
                                 the square root of its pressure drop
    c_j p_j'                     dependence of a_1 on the path after a reversal, as with a yielding load: p_j is f_r
                                 behind a play of half-width S_j (Prandtl-Ishlinskii model; Visintin 1994, Differential
                                 Models of Hysteresis, III.2)

and are sent as part of a_3, for the f_r and f_r' of the middle of the policy step in which they act. Here::

    f_c, f, terms (1 kHz) --the same state-variable filter--> F_c, phi            aligned to the sample
    100 Hz    A <- (1 - w) A + phi phi^T,  b <- (1 - w) b + phi F_c               w = dt / memory, by excitation
              a = argmin sum (F_c - phi^T a)^2 + weight |a - start|^2             within the law's limits

f and its derivatives hold the load cell's noise, which alone adds to phi phi^T, and so makes the coefficients of the
higher derivatives too small. `NOISE_SHARE` of what it adds is taken off (bias-compensated least squares: Soderstrom
2007, Automatica 43(6), 939), at most as much of the whole. It is taken for white at 1 kHz; its variance is that of the
third differences of f, which hardly show what follows a reference.

All channels pass through the same filter: a misalignment of a derivative by half a sample would be 5 % of a_1.

The box applies all of them at 1 kHz to exact derivatives of f_r. Without a_4 the full a_2 would, where f_r depends on f
as in a hybrid simulation, remove the damping of a resonance above the reference's frequencies.

A residual of the fit above `residual_threshold` indicates a change of the bench, and raises the forgetting rate.

A step with an implausible force is excluded: a load cell that is stuck or jumps, a load out of contact.

Forgetting follows excitation: without excitation nothing is forgotten, a_1, a_2, a_4, b and c hold, and a_0 and a_3
return to 1 and 0.

With a known amplifier of the load cell, f = f_s / (1 + 2 d s / w + s^2 / w^2), the fit is on the force f_s at its input
instead, F_s = F + 2 d F' / w + F'' / w^2: then the force on the specimen follows f_r.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.settings import SettingsError, check, quantity
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING

STEP_PERIOD = SAMPLES_PER_STEP * SAMPLE_PERIOD  # time [s] between two updates

FILTER_ORDER = 6  # of the state-variable filter: five derivatives, two of them for the load cell's amplifier

FILTER_SETTLING_TIME = 0.2  # settling time [s] of the filter after a gap, in which the fit is not updated

PREDICTION_HORIZON = 0.01  # prediction horizon [s] of f_r' in the further terms, from the last sample

PLAY_HALF_WIDTHS = (0.25, 0.5, 0.75)  # S_j over `force_scale`

NOISE_SHARE = 0.8
"""Of the noise in the fit, taken off: its variance is known to a tenth, and a matrix of less has no inverse."""

THIRD_DIFFERENCE_GAIN = 20.0  # variance of the third difference of white noise, over its own

INITIAL_COEFFICIENTS = np.array((1.0, 0.02, 1e-4, *[0.0] * (6 + len(PLAY_HALF_WIDTHS))))
"""Initial a_0 to a_4, b_0 to b_3, c_0 to c_2; a_1 is half the usual lag, which bounds its initial error by as much."""

LEVEL, VALVE_TERMS = 3, 5  # indices of a_3 and b_0

VALIDITY_MASK = int(Flag.ARMED | Flag.SATURATED | Flag.WATCHDOG | Flag.TRIPPED | Flag.SENSOR_FAULT)
"""Mask of the flags that decide on a sample's use: of these only ARMED may be set."""


@dataclass(frozen=True, kw_only=True)
class CompensatorSettings:
    """Settings of the coefficient estimator `Compensator`."""

    bandwidth: Annotated[float, quantity("Hz", 1.0, 50.0)] = 20.0
    """Of each pole of the filter that force and command run through."""
    memory: Annotated[float, quantity("s", 0.1, 60.0)] = 2.0
    """Time constant of forgetting under good excitation."""
    settling: Annotated[float, quantity("s", 0.01, 10.0)] = 0.3
    """Time constant with which a_0 and a_3 return to 1 and 0 where nothing is learnt."""
    weight: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-4
    """Of `INITIAL_COEFFICIENTS` in the fit; a second of a sine of 1 Hz with `force_scale` weighs 0.5."""
    third_weight: Annotated[float, quantity("-", 0.0, 10.0)] = 0.1
    """Of a_4 = 0: below 2 Hz f''' tells it badly from a_1."""
    valve_weight: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-2
    """Of the absence of the terms of b and c: smooth steps tell them badly from f'."""
    force_scale: Annotated[float, quantity("N", 1e-3, 1e7)] = NOMINAL.force
    """Usual amplitude of the force."""
    good_excitation: Annotated[float, quantity("-", 0.0, 1.0)] = 0.1
    """Excitation above which forgetting is at its fastest; `force_scale` at 1 Hz gives 1, at 0.5 Hz 0.25."""
    residual_threshold: Annotated[float, quantity("-", 1e-3, 100.0)] = 0.03
    """Residual of the fit over `force_scale` at which the forgetting rate doubles."""
    forgetting_ratio_max: Annotated[float, quantity("-", 1.0, 100.0)] = 8.0
    """Upper bound of the forgetting rate over its value at a residual of 0."""
    reversal: Annotated[float, quantity("N/s", 1e-4, 1e7)] = NOMINAL.force / 10.0
    """r, the force rate over which the valve counts as turning."""
    least_excitation: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-3
    """Excitation below which nothing is learnt."""
    jump: Annotated[float, quantity("-", 1e-3, 100.0)] = 0.2
    """Change of the force within a sample over `force_scale` that only a load cell makes."""
    no_load: Annotated[float, quantity("-", 0.0, 1.0)] = 0.02
    """Force over `force_scale` that no load is taken to have, while f_c is ten times as large."""


@dataclass(frozen=True, kw_only=True)
class LoadCell:
    """Amplifier of the load cell, a second-order low-pass."""

    bandwidth: Annotated[float, quantity("Hz", 2.0, 2000.0)]
    """Natural frequency."""
    damping: Annotated[float, quantity("-", 0.3, 2.0)] = LOAD_CELL_DAMPING
    """Damping ratio."""

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def load(cls, path: Path) -> LoadCell:
        """Read the load cell's amplifier from a bench file or a diagnosis' corrected.yaml.

        Raises SettingsError: the file has no load cell with an amplifier, or one that cannot be compensated;
        ValueError: it is no bench file; OSError: it cannot be read.
        """
        bench = Bench.load(path)
        for effect in bench.effects:  # an effect replaces `load_cell_bandwidth`
            if effect["id"] == "sensor_lag" and effect["sensor"] == "load_force":
                return cls(**effect["parameters"])
        if bench.load_cell_bandwidth is None:
            raise SettingsError(f"{path} has no load cell with an amplifier: give it load_cell_bandwidth")
        return cls(bandwidth=bench.load_cell_bandwidth)


class _Constants(NamedTuple):
    """Constants of the compiled kernels, derived from settings, law and load cell."""

    transition: FloatArray
    inputs: FloatArray  # of the state-variable filter; see `_filter`
    regressors: FloatArray  # of a_0, a_1, a_2, a_4 from the filtered force, shape (4, `FILTER_ORDER`)
    scale: FloatArray  # of each regressor, shape (12,)
    weights: FloatArray  # of `INITIAL_COEFFICIENTS`, shape (12,)
    lower: FloatArray
    upper: FloatArray  # bounds of the fit, shape (12,)
    plays: FloatArray  # S_j [N], shape (3,)
    noise: FloatArray  # of phi phi^T of a_0, a_1, a_2, a_4, from white noise of 1 N in f, shape (4, 4)


class _Memory(NamedTuple):
    """State of the estimators of n benches."""

    estimate: FloatArray  # a_0 to a_4, b_0 [N], b_1 [s], b_2 and b_3 [s/N], c_0 to c_2 [s], shape (n, 12)
    states: FloatArray  # f_c, f and the terms of b and c, filtered, and derivatives, shape (n, 9, `FILTER_ORDER`)
    last: FloatArray  # the same nine of the last sample, shape (n, 9)
    within: FloatArray  # f_r - p_j, where f_r is within each play [N], shape (n, 3)
    matrix: FloatArray
    vector: FloatArray  # of the fit, shapes (n, 12, 12) and (n, 12)
    steps: npt.NDArray[np.int64]  # since the last gap, shape (n,)
    excitation: FloatArray  # shape (n,)
    noise: FloatArray  # variance of the noise in f [N^2], shape (n,)
    noise_sum: FloatArray  # the same as `matrix` holds it [N^2 s], shape (n,)


_SETTINGS_DTYPE = np.dtype([(each.name, np.float64) for each in fields(CompensatorSettings)])


class Compensator:
    """Least-squares estimator of the compensated law's coefficients for n benches; arrays have one row per bench.

    `count`: number of benches n. `law`: compensated law, with the limits of the coefficients. `cell`: load cell whose
    input force is to follow the reference; None: the measured force follows it.
    """

    def __init__(
        self,
        count: int = 1,
        settings: CompensatorSettings | None = None,
        law: BoxLaw | None = None,
        cell: LoadCell | None = None,
    ) -> None:
        from hydro_policy.compensation import kernel  # numba: not needed to read the settings

        self._update = kernel.update
        self.settings, self.law = settings or CompensatorSettings(), law or BoxLaw()
        omega, force = 2.0 * math.pi, self.settings.force_scale  # 1 Hz
        valve = 1.0 / force, omega, omega * force, omega * force
        scale = np.array((1.0, omega, omega**2, 1.0 / force, omega**3, *valve, *[omega] * len(PLAY_HALF_WIDTHS)))
        least, most, share = self.law.coefficient_min, self.law.coefficient_max, -self.law.coefficient_min[1]
        inverse: tuple[float, ...] = (1.0,)  # polynomial in s from the cell's reading to the force in front of it
        if cell is not None:
            natural = 2.0 * math.pi * cell.bandwidth
            inverse = 1.0, 2.0 * cell.damping / natural, 1.0 / natural**2
        regressors = np.zeros((4, FILTER_ORDER))
        for row in range(4):
            regressors[row, row : row + len(inverse)] = inverse
        regressors /= force * scale[[0, 1, 2, 4], np.newaxis]
        transition, inputs = _filter(self.settings.bandwidth)
        covariance = np.zeros_like(transition)  # of the filter's state, for white noise of 1 N
        for _ in range(round(1.0 / STEP_PERIOD)):
            covariance = transition @ covariance @ transition.T + inputs.T @ inputs
        self._constants = _Constants(
            transition,
            inputs,
            regressors=regressors,
            noise=regressors @ covariance @ regressors.T,
            scale=scale,
            weights=np.array(
                [self.settings.weight] * (VALVE_TERMS - 1)
                + [self.settings.third_weight]
                + [self.settings.valve_weight] * (len(INITIAL_COEFFICIENTS) - VALVE_TERMS)
            ),
            lower=np.array(
                (*least, least[LEVEL], -share, -share / force, -share / force, *[-share] * len(PLAY_HALF_WIDTHS))
            ),
            upper=np.array((*most, most[LEVEL], share, share / force, share / force, *[share] * len(PLAY_HALF_WIDTHS))),
            plays=np.multiply(PLAY_HALF_WIDTHS, force),
        )
        self._numbers = np.array([astuple(self.settings)], _SETTINGS_DTYPE)
        self.coefficients: FloatArray = np.empty((count, VALVE_TERMS))
        """Commanded a_0 [-], a_1 [s], a_2 [s^2], a_3 [N] (with the terms of b and c), a_4 [s^3], shape (n, 5)."""
        self.counted: npt.NDArray[np.bool_] = np.zeros(count, bool)  # benches whose last step counted, shape (n,)
        self.frozen = np.zeros(count, bool)  # benches whose coefficients hold on request, shape (n,)
        self._memory = _Memory(
            estimate=np.empty((count, *INITIAL_COEFFICIENTS.shape)),
            states=np.empty((count, len(INITIAL_COEFFICIENTS) - 3, FILTER_ORDER)),
            last=np.empty((count, len(INITIAL_COEFFICIENTS) - 3)),
            within=np.empty((count, len(PLAY_HALF_WIDTHS))),
            matrix=np.empty((count, *2 * INITIAL_COEFFICIENTS.shape)),
            vector=np.empty((count, *INITIAL_COEFFICIENTS.shape)),
            steps=np.empty(count, np.int64),
            excitation=np.empty(count),
            noise=np.empty(count),
            noise_sum=np.empty(count),
        )
        self.excitation: FloatArray = self._memory.excitation
        """Excitation: mean square of f' over the memory, relative to a sine of `force_scale` at 1 Hz, shape (n,)."""
        self.reset()

    def reset(self, rows: int | slice = slice(None)) -> None:
        """Reset the estimators of these benches to `INITIAL_COEFFICIENTS`, without memory of earlier samples."""
        self.coefficients[rows] = INITIAL_COEFFICIENTS[:VALVE_TERMS]
        for array in self._memory:
            array[rows] = 0
        self._memory.estimate[rows] = INITIAL_COEFFICIENTS

    @property
    def at_bound(self) -> npt.NDArray[np.bool_]:
        """Whether a coefficient of each bench is at a limit, shape (n,)."""
        low, high = self._constants.lower, self._constants.upper
        found, level = self._memory.estimate, self.coefficients[:, LEVEL, np.newaxis]
        at = ((found <= low) | (found >= high), (level <= low[LEVEL]) | (level >= high[LEVEL]))
        return np.any(np.concatenate(at, axis=1), axis=1)

    def step(
        self,
        commanded: FloatArray,
        measured: FloatArray,
        active: npt.NDArray[np.bool_],
        reference_rate: FloatArray | None = None,
        reference: FloatArray | None = None,
    ) -> FloatArray:
        """Update the estimates with the samples of a policy step; return a copy of `coefficients`.

        `commanded`, `measured`: applied f_c and measured f [N], shape (n, 10). `active`: whether each bench's samples
        are used, shape (n,); False while disarmed, saturated or tripped, and for missing samples: the estimate holds,
        and the filter restarts afterwards. `reference_rate`, `reference`: f_r' [N/s], f_r [N], shape (n, 10); None: 0.

        An implausible force (stuck or jumping load cell, load out of contact) is treated like missing samples.
        """
        absent = np.zeros_like(measured)
        rate, value = (absent if x is None else x for x in (reference_rate, reference))
        samples = np.stack((commanded, measured, rate, value), axis=1)
        self.counted = np.empty(len(samples), np.bool_)
        self._update(self._numbers, self._constants, self._memory, samples, active, self.frozen, self.counted,
                   self.coefficients)  # fmt: skip
        return self.coefficients.copy()


def _filter(bandwidth: float) -> tuple[FloatArray, FloatArray]:
    """Discretise the state-variable filter w^n / (s + w)^n, n = `FILTER_ORDER`, over a policy step: trapezoidal, 1 kHz.

    Returns the transition matrix of (F, F', ...), shape (n, n), and the input matrix of the last sample before the step
    and the ten samples of the step, shape (11, n).
    """
    w = 2.0 * math.pi * bandwidth
    a = np.eye(FILTER_ORDER, k=1)
    a[-1] = [-math.comb(FILTER_ORDER, k) * w ** (FILTER_ORDER - k) for k in range(FILTER_ORDER)]
    b = np.zeros(FILTER_ORDER)
    b[-1] = w**FILTER_ORDER
    half = 0.5 * SAMPLE_PERIOD * a
    inverse = np.linalg.inv(np.eye(FILTER_ORDER) - half)
    one, gain = inverse @ (np.eye(FILTER_ORDER) + half), inverse @ b * 0.5 * SAMPLE_PERIOD
    transition: FloatArray = np.eye(FILTER_ORDER)
    inputs: FloatArray = np.zeros((FILTER_ORDER, SAMPLES_PER_STEP + 1))
    for k in range(SAMPLES_PER_STEP):
        transition, inputs = one @ transition, one @ inputs
        inputs[:, k] += gain
        inputs[:, k + 1] += gain
    return transition, np.ascontiguousarray(inputs.T)
