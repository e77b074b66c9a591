# SPDX-License-Identifier: Apache-2.0
"""Policy steps of 10 ms from samples of 1 ms, by their sequence numbers: the policy runs on the plant's clock.

::

    sequence   ... 19 | 20 21 22 23 24 25 26 27 28 29 | 30 ...
                        ^ step: observe, act            ^ step: reward of that action = mean over samples 21 to 30
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_core.signals import SAMPLES_PER_STEP, STATE_FIELDS, Flag, FloatArray
from hydro_policy.task.mdp.observations import LOAD_FORCE, LOAD_FORCE_RATE, REFERENCE, REFERENCE_RATE

HOLD_FLAGS = int(Flag.WATCHDOG | Flag.FILTER_STALE)
"""Flags of base gains in place of the commanded gains, so that a result is not due to the action: see `hold_flags`."""

VALVE_CURRENT, KP, KI = map(STATE_FIELDS.index, ("valve_current", "proportional_gain", "integral_gain"))


def hold_flags(flags: Any, k_p: Any, k_i: Any, base: tuple[float, float] | None) -> Any:
    """Return the bits of `HOLD_FLAGS` in samples under base gains in place of the commanded gains, else 0.

    A plant that requires no filter (`guard.require_filter`) applies commanded gains under FILTER_STALE, too: 0 there.

    `flags`, `k_p`, `k_i`: of one sample, or arrays of one shape; 1/s and 1/s^2. `base`: base gains K_p, K_i; None: each
    flagged sample counts (MISMATCH, under which narrow gains act; another law).
    """
    bits = flags & HOLD_FLAGS
    if base is None:
        return bits
    acts = ~(np.isclose(k_p, base[0], rtol=1e-5) & np.isclose(k_i, base[1], rtol=1e-5))
    return np.where(acts & (bits == Flag.FILTER_STALE), 0, bits)


@dataclass(frozen=True)
class Step:
    """Policy step: the sample to act upon, and the results of the previous action."""

    sample: FloatArray  # the step's own sample, order of STATE_FIELDS, shape (14,)
    error: FloatArray  # e [N] of the samples since the last step, this one included, shape (n,)
    error_rate: FloatArray  # e' [N/s], shape (n,)
    current: FloatArray  # consecutive u [A] received by the valve: if samples are missing, only those after the gap
    whole: bool  # every sample arrived, armed, and the box applied the gains it was given
    hold_flags: int  # bits of HOLD_FLAGS seen since the last step


@dataclass
class StepClock:
    """Assembly of samples into policy steps: every tenth sequence number completes a step.

    If that very sample is lost, the next one to arrive is the step: acting continues, but the step is not `whole`.
    """

    lost: int = 0  # sequence numbers that never arrived
    _samples: list[FloatArray] = field(default_factory=list)  # since the last step
    _unbroken: int = 0  # place among them from which on none is missing
    _last: int = -1
    _held: int = 0
    _common: int = ~0
    _gap: bool = True

    def add(
        self, sequence: int, sample: FloatArray, flags: int, base: tuple[float, float] | None = None
    ) -> Step | None:
        """Add a sample, not to be modified afterwards; returns the step that it completes, or None.

        Repeated samples are ignored. `base`: see `hold_flags`.
        """
        if sequence == self._last:
            return None
        if sequence != self._last + 1:
            self._gap, self._unbroken = True, len(self._samples)
            self.lost += max(sequence - self._last - 1, 0) if self._last >= 0 else 0
        block_changed = sequence // SAMPLES_PER_STEP != self._last // SAMPLES_PER_STEP
        self._last = sequence
        self._samples.append(sample)
        if flags & HOLD_FLAGS:
            self._held |= int(hold_flags(flags, sample[KP], sample[KI], base))
        self._common &= flags
        if not block_changed:
            return None
        complete = not self._gap and len(self._samples) == SAMPLES_PER_STEP
        whole = complete and not self._held and bool(self._common & Flag.ARMED)
        rows = np.array(self._samples)
        error, rate = rows[:, REFERENCE] - rows[:, LOAD_FORCE], rows[:, REFERENCE_RATE] - rows[:, LOAD_FORCE_RATE]
        step = Step(sample, error, rate, rows[self._unbroken :, VALVE_CURRENT], whole, self._held)
        self._samples, self._unbroken, self._held, self._common, self._gap = [], 0, 0, ~0, False
        return step
