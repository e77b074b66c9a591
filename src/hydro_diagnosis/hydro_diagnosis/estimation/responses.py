# SPDX-License-Identifier: Apache-2.0
"""Response of the residuals to a hidden input in one equation, through observer, test function and sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from hydro_diagnosis.effects import substeps
from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.kernels import fading_sums
from hydro_diagnosis.model.observer import OBSERVER_MEMORY
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model import equations as eq
from hydro_sim.model.equations import LOAD_CELL_DAMPING

UNIT_SIZE = {"pressure_a": 1e-7, "pressure_b": 1e-7, "actuation": 1e-4, "motion": 1.0, "load": 1.0}
"""Scale of the basis functions, so that columns are of similar length."""


class Responses:
    """Response of the residual vector to an input in one equation."""

    def __init__(self, problem: Problem, claims: Sequence[Claim], equation: str, sensor: str) -> None:
        self.problem = problem
        self.equation, self.sensor = equation, sensor
        everything = (*problem.baseline, *claims)
        self._benches = [model.bench(everything) for model in problem.models]
        self._stiff: list[tuple[FloatArray, FloatArray]] = []
        self._roots: list[tuple[FloatArray, FloatArray]] = []
        if "pressure" in problem.blocks and equation in ("pressure_a", "pressure_b", "actuation"):
            for model, bench in zip(problem.models, self._benches, strict=True):
                oil = model.oil(everything)
                self._stiff.append(chambers.compliances(bench, oil, everything))
                opened = substeps.mean(oil.spool) >= 0
                drops = zip(*eq.edge_drops(bench.supply_pressure, bench.tank_pressure, *oil.pressures), strict=True)
                root_a, root_b = (eq.signed_root(np.where(opened, out, back)) for out, back in drops)
                self._roots.append((root_a, root_b))

    @property
    def visible(self) -> bool:
        """Whether the recordings hold the channels in which this input shows."""
        blocks = self.problem.blocks
        if self.equation in ("pressure_a", "pressure_b", "actuation"):
            return "pressure" in blocks
        if self.equation in ("motion", "load"):
            return self.equation in blocks
        return self.sensor in self.problem.sensor_noise and any(block != "motion" for block in blocks)

    def of(self, inputs: Sequence[FloatArray]) -> FloatArray:
        """Residual vector's change for an input given per segment."""
        problem = self.problem
        shown = [self._channels(k, model, inputs[k]) for k, model in enumerate(problem.models)]
        layout = problem.layout
        vector = np.zeros(len(layout.channel))
        for index, name in enumerate(CHANNELS):
            for k in range(len(problem.models)):
                if name in shown[k]:
                    at = (layout.channel == index) & (layout.segment == k)
                    vector[at] = shown[k][name] / problem.deviation(name, k)
        return vector

    def _channels(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        if not np.any(hidden):
            return {}
        if self.equation in ("pressure_a", "pressure_b", "actuation"):
            return self._chambers(k, model, hidden)
        if self.equation == "motion":
            return {"motion": -model.kept_finish(hidden)}
        if self.equation == "load":
            return self._load(k, model, hidden)
        return self._sensor(k, model, hidden)

    def _chambers(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        scale = UNIT_SIZE[self.equation] * model.step
        shown = {}
        for index, name in enumerate(("pressure_a", "pressure_b")):
            if self.equation not in (name, "actuation"):
                continue
            flow = hidden * scale
            if self.equation == "actuation":
                flow = flow * self._benches[k].valve_gain * self._roots[k][index] * (1.0 if index == 0 else -1.0)
            built = fading_sums((self._stiff[k][index] * flow)[None], 1.0 - model.step / OBSERVER_MEMORY)[0]
            shown[name] = -model.kept_smooth(built)
        return shown

    def _load(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        bandwidth = self._benches[k].load_cell_bandwidth
        seen = hidden if bandwidth is None else model.memory.low_pass("", hidden, bandwidth, LOAD_CELL_DAMPING)
        shown = {"load": -model.kept_smooth(seen)}
        if "motion" in self.problem.blocks:
            shown["motion"] = -model.kept_finish(hidden)
        return shown

    def _sensor(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        shown: dict[str, FloatArray] = {}
        means = model.means(hidden)
        area = self._benches[k].piston_area
        if self.sensor == "load_force":
            return {"load": model.kept_smooth(hidden)}
        if self.sensor == "hydraulic_force":
            shown["motion"] = model.kept_smooth(hidden)
            shown["hydraulic"] = means
        else:
            shown[self.sensor] = model.kept_smooth(forget(hidden, model.step)) * 1e4
            share = 1.0 if self.sensor == "pressure_a" else -self._benches[k].area_ratio
            shown["hydraulic"] = -area * share * means * 1e4
        present = {CHANNELS[index] for index in np.unique(self.problem.layout.channel)}
        return {name: signal for name, signal in shown.items() if name in present}


def forget(signal: FloatArray, step: float) -> FloatArray:
    """High-pass effect of a slow observer on a signal."""
    gain = step / OBSERVER_MEMORY
    followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], signal, zi=[signal[0]])
    return signal - np.asarray(followed)
