# SPDX-License-Identifier: Apache-2.0
"""Learned residual of the compensated law: a network predicts the repeatable force error, and corrects it by a_3.

The compensated law's remaining error repeats with the reference: friction and overlap at reversals of the force, an
asymmetric valve. The network is trained on many randomised benches; its inputs on the present bench are::

    z        f_r' of the last 90 ms through tanh, f_r, f_r''             the reference
    c z      correlation of past needed corrections with z, times z      the bench's past errors
    a        coefficients of the law, mean and spread of a_3             the estimator's state
    y, m     recent needed corrections, and their mean over similar z    a memory of the last 4 s

Every policy step (10 ms) it predicts the correction p [N] of the force that is needed 16 and 26 ms from the last
sample. Where the reference is periodic (`PeriodDetector`) the corrections needed one to three periods ago replace the
prediction, weighted by how little the law's coefficients have changed since (repetitive control: Longman 2000, Int. J.
Control 73(10), 930). The law's polynomial, an inverse model of the compensated loop, turns p into an addition to a_3::

    w = a_0 p + a_1 p'                    bounded, ramped in over 0.5 s, within the law's limits and rates of a_3

Its authority, the share of p that is applied, follows the correlation of S(e) with p: where p is too large or late for
this bench, e has the opposite sign, and the authority shrinks until e no longer contains p; where p would reduce e it
grows. A large w indicates coefficients that have not converged, and less of p is applied: on soft springs with slow
load cells estimator and residual otherwise kept each other from converging.

Excluded samples, of a saturated valve for instance, pause the residual; its memory of the bench is retained.

The needed correction is the ideal one in hindsight, y = S(e + p), known 40 ms later; S smooths with a Gaussian of 8 ms,
p acts 8 ms after the command. The law's estimator uses f_c and f with w and its effect included.

No preview of the reference is needed: the box may follow any. A residual of zero leaves the compensated law. Source of
the scheme: iterative learning control (Bristow et al. 2006, IEEE Control Systems 26(3), 96) with the iteration replaced
by a network over benches, as in rapid motor adaptation (Kumar et al. 2021, RSS XVII).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLES_PER_STEP, FloatArray
from hydro_policy.compensation.estimator import Compensator
from hydro_sim.files import weights

PERIOD_MAX = 400  # longest detectable period, policy steps (4 s)
WINDOW_MIN = 50  # shortest averaging window of a difference, policy steps
PERIOD_DIFFERENCE, DISTINCT_DIFFERENCE = 0.01, 1.0
"""Thresholds of the mean squared difference at a lag over the reference's variance: a lag below the first is a period
if a shorter lag exceeds the second."""
_AVERAGING_RATE = 1.0 / 300.0  # averaging rate of mean and variance, per policy step


class PeriodDetector:
    """Online detector of the period of n benches' references; arrays have one row per bench."""

    def __init__(self, count: int) -> None:
        self._lags = np.arange(1, PERIOD_MAX + 1)
        self._past: FloatArray = np.zeros((count, PERIOD_MAX))  # newest first
        self._difference: FloatArray = np.zeros((count, PERIOD_MAX))
        self._mean: FloatArray = np.zeros(count)
        self._variance: FloatArray = np.zeros(count)
        self.steps: FloatArray = np.zeros(count)  # detected period [policy steps], shape (n,); 0: none
        self.confidence: FloatArray = np.zeros(count)
        """Confidence in the period, 0 to 1: similarity of the reference to itself a period earlier, shape (n,)."""

    def step(self, reference: FloatArray, age: npt.NDArray[np.int64]) -> None:
        """Update by one policy step: its reference, shape (n,), and the number of steps observed so far, shape (n,)."""
        change = _AVERAGING_RATE * (age > 0)
        self._mean = np.where(age > 1, self._mean + change * (reference - self._mean), reference)
        self._variance = np.where(
            age > 1, self._variance + change * ((reference - self._mean) ** 2 - self._variance), 0
        )
        seen = age[:, np.newaxis] - self._lags  # comparisons so far
        share = 1.0 / np.clip(seen, 1.0, np.maximum(self._lags, WINDOW_MIN))
        difference = (reference[:, np.newaxis] - self._past) ** 2
        self._difference = np.where(seen > 0, self._difference + share * (difference - self._difference), 0.0)
        self._past = np.concatenate((reference[:, np.newaxis], self._past[:, :-1]), axis=1)
        d, power = self._difference, self._variance[:, np.newaxis] + 1e-12
        behind = np.maximum.accumulate(d, axis=1) > DISTINCT_DIFFERENCE * power
        inner = d[:, 1:-1]
        low = (inner <= d[:, :-2]) & (inner < d[:, 2:]) & (inner < PERIOD_DIFFERENCE * power) & behind[:, 1:-1]
        low &= seen[:, 1:-1] > np.maximum(WINDOW_MIN, self._lags[1:-1]) // 2
        first, rows = np.argmax(low, axis=1), np.arange(len(d))
        found = low[rows, first]
        left, middle, right = (d[rows, first + k] for k in (0, 1, 2))
        bend = left - 2.0 * middle + right
        shift = np.clip(0.5 * (left - right) / np.where(bend > 0.0, bend, 1.0), -0.5, 0.5)
        least = np.maximum(middle - 0.25 * (left - right) * shift, 0.0)
        self.steps = np.where(found, self._lags[first + 1] + shift, 0.0)
        self.confidence = np.where(found, 1.0 - np.clip(least / (PERIOD_DIFFERENCE * power[:, 0]), 0.0, 1.0), 0.0)


STRUCTURE = "residual"  # value of `structure` in the header of a weights file
NOMINAL_SCALE = 300.0
"""Force scale [N] of the training benches; forces of another bench are scaled to it."""

RATE_LAGS = np.array((0, 5, 10, 20, 35, 55, 90))  # lags of f_r' in z, samples before the last one
LOOKAHEAD, KERNEL_HALF_LENGTH, KERNEL_SIGMA, PREDICTION_LATENCY = 16, 24, 8.0, 12
"""Horizon of the predicted correction from the last sample; half length and standard deviation of the kernel S; latency
from the start of a policy step to the effect of its p; all in samples.

In the graph a_3 acts from the fifth sample after the one on which it was decided (`benchmarks.residual`)."""
KERNEL = np.exp(-0.5 * (np.arange(-KERNEL_HALF_LENGTH, KERNEL_HALF_LENGTH + 1) / KERNEL_SIGMA) ** 2)
KERNEL /= KERNEL.sum()
CORRECTION_DELAY = 4  # policy steps after which a needed correction is known
BUFFER_STEPS = 12  # policy steps whose samples are buffered
MEMORY_STEPS = 400  # needed corrections in memory, 4 s
CORRECTION_LAGS = (0, 2, 5, 10, 20, 40)  # lags of the recent needed corrections, policy steps before the last one
SIMILARITY_WIDTHS = (0.25, 0.6)  # widths of the Gaussian kernels for the mean over similar z
PERIOD_WEIGHTS = (1.0, 0.5, 0.25)  # weights of the corrections needed one, two and three periods ago
SMOOTHING_WEIGHTS = np.array((1.0, 2.0, 3.0, 2.0, 1.0)) / 9.0  # of these corrections, over policy steps
SMOOTHING_DELAY = CORRECTION_DELAY + 1 + len(SMOOTHING_WEIGHTS) // 2
"""Policy steps after which the smoothed corrections of a step and the next are known."""
SETTLING_STEPS = BUFFER_STEPS + 100  # initial policy steps whose corrections are not repeated: the law converges
HALF_WEIGHT_CHANGE = 1.0  # N at `NOMINAL_SCALE`: change of the law's f_c since a correction at which its weight halves
REPEAT_GAIN = 0.9  # share of a repeated correction that is applied
FORGETTING_RATE = 0.01 / 1.5  # forgetting rate of the correlations, per policy step

TERM_COUNT = 3 * len(RATE_LAGS) + 4  # entries of z
INPUT_COUNT = 2 * TERM_COUNT + 6 + len(CORRECTION_LAGS) + 2 * len(SIMILARITY_WIDTHS)
OUTPUT_COUNT = 2
DISTANCE_WEIGHTS = np.array([0.5, 0.7, 1.0] * len(RATE_LAGS) + [1.5, 0.7, 1.0, 0.0])
"""Weights of the entries of z in the distance between two situations, shape (`TERM_COUNT`,)."""

WARM_UP_STEPS, RAMP_STEPS = 65, 50  # policy steps before the residual acts, and over which it is ramped in
PAUSE_STEPS_MAX, RESTART_RAMP_STEPS = 100, 15
"""Policy steps: length of a pause after which the warm-up restarts, and of the ramp after a shorter pause."""
HALF_AUTHORITY_RMS, MEAN_SQUARE_RATE = 9.0, 0.03
"""RMS of w [N at `NOMINAL_SCALE`] at which half of the prediction is applied; averaging rate of its square per step."""
PREDICTION_MAX, RESIDUAL_MAX = 12.0, 30.0  # bounds of p and of w, N at `NOMINAL_SCALE`
PREDICTION_GAIN = 0.8  # share of the prediction that is applied
PRODUCT_RATE, AUTHORITY_RATE = 0.01, 0.03
"""Per policy step: rate of the averaged products of S(e) and p, and of the authority that follows them."""
POWER_REGULARISATION = 0.01  # N^2 at `NOMINAL_SCALE`: regularisation, added to the mean square of p


@dataclass(frozen=True)
class Network:
    """Perceptron with SiLU hidden layers, and the mean and standard deviation that normalise its inputs."""

    mean: FloatArray
    spread: FloatArray
    layers: tuple[tuple[FloatArray, FloatArray], ...]  # (weight, bias) of each layer, shapes (in, out) and (out,)

    @classmethod
    def load(cls, path: Path | None = None) -> Network:
        """Read a weights file; None: the file shipped with this package.

        Raises WeightsError: the file is missing, damaged, or of another structure.
        """
        if path is None:
            with resources.as_file(resources.files("hydro_policy") / "data" / "residual.safetensors") as shipped:
                return cls.load(shipped)
        tensors, header = weights.load(path)
        if header.get("structure") != STRUCTURE or tensors["mean"].shape != (INPUT_COUNT,):
            raise weights.WeightsError(f"{path} holds no residual of this version: train it again")
        count = sum(name.startswith("weight") for name in tensors)
        layers = tuple((tensors[f"weight_{k}"].astype(float), tensors[f"bias_{k}"].astype(float)) for k in range(count))
        return cls(tensors["mean"].astype(float), tensors["spread"].astype(float), layers)

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return predictions [N at `NOMINAL_SCALE`], shape (n, 2), of inputs, shape (n, `INPUT_COUNT`)."""
        x = np.clip((inputs - self.mean) / self.spread, -6.0, 6.0)
        *hidden, (weight, bias) = self.layers
        for inner, offset in hidden:
            x = x @ inner + offset
            x = x / (1.0 + np.exp(-x))
        return np.asarray(x @ weight + bias)


class Residual:
    """Learned residual in a_3 of n benches; arrays have one row per bench.

    `count`: number of benches n. `network`: predictor; None: a residual of zero, with inputs and needed corrections
    (`inputs`, `needed`) for training. `scale`: usual amplitude of the force [N], `CompensatorSettings.force_scale`.
    """

    def __init__(self, count: int = 1, network: Network | None = None, scale: float = NOMINAL_SCALE) -> None:
        self._network, self._scale = network, scale / NOMINAL_SCALE
        self._count = count
        self.reset()

    def reset(self) -> None:
        """Reset to the initial state: no samples, no corrections, full authority."""
        n, samples = self._count, BUFFER_STEPS * SAMPLES_PER_STEP
        self.value: FloatArray = np.zeros(n)  # w [N], to be added to a_3 of the next policy step, shape (n,)
        self.inputs: FloatArray = np.zeros((n, INPUT_COUNT))  # of the network at the last step
        self.needed: FloatArray = np.zeros(n)
        """Correction [N at `NOMINAL_SCALE`] needed `CORRECTION_DELAY` steps ago, shape (n,)."""
        self.age: npt.NDArray[np.int64] = np.zeros(n, np.int64)  # policy steps since it started, shape (n,)
        self._counting: npt.NDArray[np.int64] = np.zeros(n, np.int64)  # last policy steps that counted
        self._pause: npt.NDArray[np.int64] = np.zeros(n, np.int64)  # that did not
        self._mean_square: FloatArray = np.zeros(n)  # mean square of w of late with full authority
        self.authority: FloatArray = np.ones(n)  # share of p that is applied, by whether it helps, shape (n,)
        self._product, self._power = np.zeros(n), np.zeros(n)
        self._rate: FloatArray = np.zeros((n, samples))
        self._error: FloatArray = np.zeros((n, samples))
        self._predicted: FloatArray = np.zeros((n, BUFFER_STEPS))  # p of the last steps, the one that acts next last
        self._full_prediction: FloatArray = np.zeros((n, BUFFER_STEPS))  # the same with full authority
        self._seen: FloatArray = np.zeros((n, CORRECTION_DELAY + 1, TERM_COUNT))  # z of the last steps
        self._zy, self._zz = np.zeros((n, TERM_COUNT)), np.zeros((n, TERM_COUNT))
        self._y, self._z = np.zeros((n, MEMORY_STEPS)), np.full((n, MEMORY_STEPS, TERM_COUNT), 1e3)
        self._mean, self._variance = np.zeros(n), np.zeros(n)
        self._period = PeriodDetector(n)
        self._recent: FloatArray = np.zeros((n, SMOOTHING_DELAY + 1, 9))  # needed correction, law, reference
        self._past: FloatArray = np.zeros((n, len(PERIOD_WEIGHTS) * PERIOD_MAX, OUTPUT_COUNT + 8))
        """Of the last steps, in turn: corrections, law, reference."""
        self._steps = 0

    def step(
        self,
        reference: FloatArray,
        rate: FloatArray,
        measured: FloatArray,
        coefficients: FloatArray,
        counted: npt.NDArray[np.bool_],
    ) -> FloatArray:
        """Update with the samples of a policy step; return a copy of the residual `value` for the next one.

        `reference`, `rate`, `measured`: f_r [N], f_r' [N/s] and f [N], shape (n, 10). `coefficients`: a_0 to a_4 of the
        law without a residual, shape (n, 5). `counted`: whether each bench's samples are used (`Compensator.counted`),
        shape (n,); other benches pause, for more than `PAUSE_STEPS_MAX` steps with a restart of the warm-up.
        """
        finite = (np.isfinite(signal).all(axis=1) for signal in (reference, rate, measured, coefficients))
        fine: npt.NDArray[np.bool_] = np.all(tuple(finite), axis=0)
        a = np.where(fine[:, np.newaxis], coefficients[:, :4], 0.0)  # what it was trained on
        rates = np.where(fine[:, np.newaxis], rate, 0.0) / self._scale
        fine &= counted
        error = np.where(fine[:, np.newaxis], reference - measured, 0.0) / self._scale
        self._rate = np.concatenate((self._rate[:, SAMPLES_PER_STEP:], rates), axis=1)
        self._error = np.concatenate((self._error[:, SAMPLES_PER_STEP:], error), axis=1)
        self._counting, self._pause = np.where(fine, self._counting + 1, 0), np.where(fine, 0, self._pause + 1)
        self.age = np.where(fine | (self.age > 0) & (self._pause <= PAUSE_STEPS_MAX), self.age + 1, 0)
        self._learn()
        now = np.where(np.isfinite(reference[:, -1]), reference[:, -1], 0.0) / self._scale
        self._period.step(now, self.age)
        past = self._rate[:, self._rate.shape[1] - 1 - RATE_LAGS]
        second = (self._rate[:, -1] - self._rate[:, -1 - SAMPLES_PER_STEP]) / 0.01  # f_r''
        shaped = np.stack((np.tanh(past / 60.0), np.tanh(past / 400.0), past / 2000.0), axis=2).reshape(len(past), -1)
        plain = (now / 250.0, np.tanh(second / 4000.0), second / 20000.0, np.ones_like(second))
        z = np.concatenate((shaped, np.stack(plain, axis=1)), axis=1)
        # the corrections needed at the step `SMOOTHING_DELAY` ago and at the one behind it, its law and reference
        shape = np.stack((self.needed, *a.T[:3], a[:, 3] / self._scale, now, self._rate[:, -1], second), axis=1)
        shape = np.concatenate((shape, np.ones((self._count, 1))), axis=1)
        late = self._recent = np.concatenate((self._recent[:, 1:], shape[:, np.newaxis]), axis=1)
        # its correction acts `LOOKAHEAD` samples later
        taps, part = len(SMOOTHING_WEIGHTS), LOOKAHEAD / SAMPLES_PER_STEP - 1.0
        corrections = (late[:, -1 - taps : -1, 0] @ SMOOTHING_WEIGHTS, late[:, -taps:, 0] @ SMOOTHING_WEIGHTS)
        acted = (1.0 - part) * late[:, 1, 5:] + part * late[:, 2, 5:]
        entry = np.concatenate((np.stack(corrections, axis=1), late[:, 0, 1:5], acted), axis=1)
        self._past[:, self._steps % self._past.shape[1]] = entry
        self._seen = np.concatenate((self._seen[:, 1:], z[:, np.newaxis]), axis=1)
        self.inputs = self._inputs(z, a)
        self._predict(a)
        return self.value.copy()

    def _learn(self) -> None:
        """Compute the correction needed `CORRECTION_DELAY` steps ago; update authority, correlations, memory by it."""
        # first sample of S, among the kept ones
        first = (BUFFER_STEPS - CORRECTION_DELAY) * SAMPLES_PER_STEP + LOOKAHEAD - 1 - KERNEL_HALF_LENGTH
        at = (np.arange(first, first + len(KERNEL)) - PREDICTION_LATENCY) / SAMPLES_PER_STEP
        low = np.clip(np.floor(at).astype(int), 0, BUFFER_STEPS - 1)
        high, between = np.minimum(low + 1, BUFFER_STEPS - 1), at - low
        acted, wished = (
            one[:, low] * (1.0 - between) + one[:, high] * between for one in (self._predicted, self._full_prediction)
        )
        known = self._counting > BUFFER_STEPS
        error = self._error[:, first : first + len(KERNEL)]
        self.needed = np.where(known, (error + acted) @ KERNEL, 0.0)
        left, predicted, share = error @ KERNEL, wished @ KERNEL, PRODUCT_RATE * known
        self._product += share * (left * predicted - self._product)
        self._power += share * (predicted**2 - self._power)
        change = AUTHORITY_RATE * np.clip(self._product / (self._power + POWER_REGULARISATION), -1.0, 1.0)
        self.authority = np.clip(self.authority + known * (self.age > WARM_UP_STEPS + RAMP_STEPS) * change, 0.0, 1.0)
        z = self._seen[:, -CORRECTION_DELAY]
        self._zy += FORGETTING_RATE * known[:, np.newaxis] * (self.needed[:, np.newaxis] * z - self._zy)
        self._zz += FORGETTING_RATE * known[:, np.newaxis] * (z * z - self._zz)
        place = self._steps % MEMORY_STEPS
        self._y[:, place] = self.needed
        self._z[:, place] = np.where(known[:, np.newaxis], z * DISTANCE_WEIGHTS, 1e3)
        self._steps += 1

    def _inputs(self, z: FloatArray, a: FloatArray) -> FloatArray:
        """Return the network's inputs, shape (n, `INPUT_COUNT`); `z`: (n, `TERM_COUNT`), `a`: a_0 to a_3, (n, 4)."""
        level = a[:, 3] / self._scale
        self._mean += 0.02 * (level - self._mean)
        self._variance += 0.02 * ((level - self._mean) ** 2 - self._variance)
        spread = np.sqrt(self._variance) / 5.0
        law = (20.0 * (a[:, 0] - 1.0), 40.0 * (a[:, 1] - 0.04), 2000.0 * (a[:, 2] - 5e-4), self._mean / 10.0, spread,
               level / 10.0)  # fmt: skip
        late = [self._y[:, (self._steps - 1 - lag) % MEMORY_STEPS] for lag in CORRECTION_LAGS]
        distance = np.sum((self._z - (z * DISTANCE_WEIGHTS)[:, np.newaxis]) ** 2, axis=2)
        alike = []
        for width in SIMILARITY_WIDTHS:
            near = np.exp(-distance / (2.0 * width * width))
            total = near.sum(1)
            alike += [np.sum(near * self._y, axis=1) / (total + 1.0), total / (total + 5.0)]
        correlation = self._zy / (self._zz + 0.02)
        return np.concatenate((z, correlation * z, np.stack((*law, *late, *alike), axis=1)), axis=1)

    def _predict(self, a: FloatArray) -> None:
        predicted: FloatArray = np.zeros((self._count, OUTPUT_COUNT))
        if self._network is not None:
            law = a / np.array((1.0, 1.0, 1.0, self._scale))
            total, weight = np.zeros((self._count, OUTPUT_COUNT)), np.zeros((self._count, 1))
            for number, usual in enumerate(PERIOD_WEIGHTS):  # corrections needed whole periods ago
                back = (number + 1) * self._period.steps - SMOOTHING_DELAY
                known = (back >= 0.0) & (back + SMOOTHING_DELAY + SETTLING_STEPS < self.age)
                back = np.where(known, back, 0.0)
                low, length = np.floor(back).astype(int), self._past.shape[1]
                between = (back - low)[:, np.newaxis]
                late, early = (self._past[np.arange(self._count), (self._steps - low - k) % length] for k in (0, 1))
                then = (1.0 - between) * late + between * early
                changed = np.sum((then[:, OUTPUT_COUNT : OUTPUT_COUNT + 4] - law) * then[:, OUTPUT_COUNT + 4 :], axis=1)
                share = (usual * known / (1.0 + (changed / HALF_WEIGHT_CHANGE) ** 2))[:, np.newaxis]
                total, weight = total + share * then[:, :OUTPUT_COUNT], weight + share
            repeated = total / np.maximum(weight, 1e-6)
            confidence = self._period.confidence[:, np.newaxis] * np.minimum(weight, 1.0)
            predicted = (1.0 - confidence) * PREDICTION_GAIN * self._network(self.inputs)
            predicted += confidence * REPEAT_GAIN * repeated
        ramp = np.clip((self.age - WARM_UP_STEPS) / RAMP_STEPS, 0.0, 1.0)
        ramp = (ramp * np.clip(self._counting / RESTART_RAMP_STEPS, 0.0, 1.0))[:, np.newaxis]
        sound = np.isfinite(predicted).all(axis=1, keepdims=True)
        wished = np.where(sound, np.clip(ramp * predicted, -PREDICTION_MAX, PREDICTION_MAX), 0.0)
        full = a[:, 0] * wished[:, 0] + a[:, 1] * (wished[:, 1] - wished[:, 0]) / 0.01
        self._mean_square += MEAN_SQUARE_RATE * (full**2 - self._mean_square)
        wished /= 1.0 + (self._mean_square[:, np.newaxis] / HALF_AUTHORITY_RMS**2) ** 2
        p = self.authority[:, np.newaxis] * wished
        w = a[:, 0] * p[:, 0] + a[:, 1] * (p[:, 1] - p[:, 0]) / 0.01
        self.value = np.clip(w, -RESIDUAL_MAX, RESIDUAL_MAX) * self._scale
        self._predicted = np.concatenate((self._predicted[:, 1:], p[:, :1]), axis=1)
        self._full_prediction = np.concatenate((self._full_prediction[:, 1:], wished[:, :1]), axis=1)


class AdaptedLaw:
    """Adapted compensated law of n benches: the estimator's a_0 to a_4, plus the learned residual in a_3.

    `estimator`: estimator of the n benches. `residual`: residual of the same benches; None: none is added.
    """

    def __init__(self, estimator: Compensator, residual: Residual | None = None) -> None:
        self.estimator, self.residual = estimator, residual
        self._low, self._high = estimator.law.coefficient_min[3], estimator.law.coefficient_max[3]
        self.learned = residual is not None  # whether the residual acts
        self.added: FloatArray = np.zeros(len(estimator.coefficients))
        """Residual added to a_3 in the present policy step [N], shape (n,)."""

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients a_0 to a_4 to command, residual included, shape (n, 5); a copy."""
        a = self.estimator.coefficients.copy()
        a[:, 3] += self.added
        return a

    def reset(self, *, learned: bool) -> None:
        """Reset estimator, residual, and coefficients to `estimator.INITIAL_COEFFICIENTS`; frozen ones are kept.

        `learned`: whether the residual acts from now on.
        """
        self.learned = learned and self.residual is not None
        if not self.estimator.frozen.all():
            self.estimator.reset()
        if self.residual is not None:
            self.residual.reset()
        self.added[:] = 0.0

    def step(
        self,
        commanded: FloatArray,
        measured: FloatArray,
        active: npt.NDArray[np.bool_],
        reference_rate: FloatArray,
        reference: FloatArray,
    ) -> None:
        """Update estimator and residual with the samples of a policy step; arguments as of `Compensator.step`."""
        a = self.estimator.step(commanded, measured, active, reference_rate, reference)
        if self.residual is None or not self.learned:
            self.added[:] = 0.0
            return
        counted = self.estimator.counted & ~self.estimator.frozen
        value = self.residual.step(reference, reference_rate, measured, a, counted)
        self.added = np.where(self.estimator.frozen, 0.0, np.clip(a[:, 3] + value, self._low, self._high) - a[:, 3])
