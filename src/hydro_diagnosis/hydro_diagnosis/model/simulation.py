# SPDX-License-Identifier: Apache-2.0
"""Forward simulation of a segment's windows by the bench's compiled model, from the recorded valve current.

The model's hidden states (of lags, presliding, play, droop) at a window's begin are those that follow the recorded
motion and pressures from the segment's first sample on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import EffectHypothesis, FloatArray, claims_acting_in
from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.equations import READINGS

WindowStarts = npt.NDArray[np.int64]
"""Indices of the samples at which windows begin."""
_TEXTBOOK = [2, 3, 0, 1]
"""Order of the model's states in which x_p, x_p', p_a and p_b come first."""


class WindowSimulation:
    """Simulation of a segment's windows under claims."""

    def __init__(self, model: SegmentModel, claims: Sequence[EffectHypothesis]) -> None:
        self.model, self.claims = model, claims

    @property
    def has_stiction(self) -> bool:
        """Whether dry friction can hold the piston: not if bristles represent it."""
        bristles = any(claim.effect.models_presliding for claim in self.claims)
        return bool(claims_acting_in(self.claims, "dry_level")) and not bristles

    @cached_property
    def recorded(self) -> FloatArray:
        """Smoothed states of the recording at each sample, shape (4, n): x_p, x_p', p_a, p_b."""
        true = self.model.with_true_position(self.claims)
        pressures = [true.smooth(true.true_signal("pressure_" + chamber, self.claims)) for chamber in "ab"]
        return np.stack([true.x, true.v, *pressures])

    def readings(self, starts: FloatArray, begins: WindowStarts, length: int) -> dict[str, FloatArray]:
        """Return the sensors' readings by channel, shape (length, variants * windows).

        `starts`: x_p, x_p', p_a and p_b at the windows' begins, shape (4, variants * windows).
        """
        lanes = np.tile(begins, starts.shape[1] // len(begins))
        states = self._states[lanes]
        states[:, _TEXTBOOK] = starts.T
        shown = self._simulated.windows(self._coefficients, states, self._currents, lanes, length)
        return {name: shown[:, :, k].T for k, name in enumerate(READINGS) if name in self.model.channels}

    @cached_property
    def _simulated(self) -> BenchModel:
        return BenchModel(bench_with(self.model.bench(self.claims), self.claims), period=self.model.step)

    @cached_property
    def _coefficients(self) -> FloatArray:
        return self._simulated.begin(self._simulated.values)[0]

    @cached_property
    def _currents(self) -> FloatArray:
        return np.ascontiguousarray(self.model.channels["valve_current"], dtype=np.float64)

    @cached_property
    def _states(self) -> FloatArray:
        """States of the bench's model at each sample, shape (n, states)."""
        recorded = np.ascontiguousarray(self.recorded[_TEXTBOOK].T)
        simulated = self._simulated
        k, y, _ = simulated.begin(simulated.values, np.array([*recorded[0], 0.0, 0.0]))
        for i, one in enumerate(simulated.states):
            if one.name == "time":
                y[i] = self.model.segment.start
        return simulated.hidden_states(k, y, self._currents, recorded)


def bench_with(bench: Bench, claims: Sequence[EffectHypothesis]) -> Bench:
    """Return a bench, already corrected by claims, with the others as its effects and closures, in their order."""
    listed = [one for one in claims if one.effect.lagged_channel or not one.effect.acts_in("correct")]
    return replace(
        bench,
        effects=tuple(one.to_mapping() for one in listed if not is_closure(one.effect)),
        closures=tuple(one.effect.to_closure(one.values) for one in claims if is_closure(one.effect)),
        learned=None,
    )
