# SPDX-License-Identifier: Apache-2.0
"""A recording as the peers see it, the nominal equations along it, and the held-out error of a corrected model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.estimation.problem import sensor_noise
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.validation import HORIZON, WINDOWS, errors
from hydro_sim.model.bench import Bench

DYNAMIC = ("velocity", "pressure_a", "pressure_b")
"""Equations that are integrated."""
READ = ("load_force", "hydraulic_force")
"""Equations that sensors read off."""
Signals = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Recordings:
    """One case: what is fitted, what is held out, and the noise of the sensors."""

    fitted: list[SegmentModel]
    held: list[SegmentModel]
    noise: dict[str, float]


def load(folder: Path) -> Recordings:
    """A case of a proof."""
    bench = Bench.nominal()
    fitted, held, _ = load_dataset([folder / name for name in FITTED], [folder / HELD], bench)
    models = [SegmentModel(segment, bench) for segment in fitted]
    return Recordings(models, [SegmentModel(segment, bench) for segment in held], sensor_noise(models))


def signals(model: SegmentModel) -> Signals:
    """What the models' terms are made of, each of shape (n,): as recorded, but velocity by a Gaussian of 1.5 ms."""
    current = model.channels["valve_current"]
    before = np.concatenate([current[:1], current[:-1]])
    made = {
        "time": model.time,
        "position": model.x,
        "velocity": model.v,
        "pressure_a": model.channels["pressure_a"],
        "pressure_b": model.channels["pressure_b"],
        "hydraulic_force": model.channels["hydraulic_force"],
        "current": 0.5 * (before + current),  # it is held for a sample: this is its mean around the sample
        "later": np.concatenate([before[:1], 0.5 * (before + current)[:-1]]),
    }
    for corner in LAGS:
        made[f"lag{corner}"] = _lagged(made["current"], 1.0 / (2.0 * np.pi * corner), model.step)
    demand = np.maximum(made["current"], 0.0)
    for seconds in DROOPS:
        made[f"droop{seconds:g}"] = _lagged(demand, seconds, model.step)
    return made


LAGS, DROOPS = (60, 110, 180), (0.02, 0.1, 0.3)
"""Hz, s."""


def _lagged(signal: FloatArray, seconds: float, step: float) -> FloatArray:
    keep = float(np.exp(-step / seconds))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], signal, zi=[keep * signal[0]])[0])


Correction = Callable[[Signals], dict[str, FloatArray]]
"""From signals of any shape to what is added to the nominal rates and readings, by equation."""


@dataclass(frozen=True)
class Corrected(Plant):
    """The nominal plant with a peer's correction of its rates; the readings' is taken along the recording."""

    correction: Correction = dict
    driving: Signals | None = None
    shown: Signals | None = None

    @classmethod
    def by(cls, model: SegmentModel, correction: Correction) -> Corrected:
        """The model of a recording with a correction."""
        plain, along = Plant.of(model, ()), signals(model)
        driving = {**along, "current": model.channels["valve_current"]}  # held from each sample on
        return cls(**vars(plain), correction=correction, driving=driving, shown=correction(along))

    @property
    def textbook(self) -> bool:
        """Never: the rates are corrected."""
        return False

    def rates(self, state: FloatArray, time: FloatArray, *rest: object) -> FloatArray:
        """The nominal rates and the correction."""
        change = super().rates(state, time, *rest)
        sample = np.floor((time - self.model.time[0]) / self.model.step + 1e-6).astype(
            int
        )  # a current holds until the next
        at = np.minimum(sample, len(self.model.time) - 1)
        here = {name: signal[at] for name, signal in self.driving.items() if name not in _STATES}
        added = self.correction({**here, **dict(zip(_STATES, state, strict=True))})
        for row, name in ((1, "velocity"), (2, "pressure_a"), (3, "pressure_b")):
            change[row] += added.get(name, 0.0)
        return change

    def measurements(self, states: FloatArray, begins: np.ndarray) -> dict[str, FloatArray]:
        """The nominal readings and the correction."""
        shown = super().measurements(states, begins)
        at = np.tile(begins, states.shape[2] // len(begins))[None, :] + np.arange(states.shape[0])[:, None]
        return {
            name: value + (self.shown[name][at] if name in READ and name in self.shown else 0.0)
            for name, value in shown.items()
        }


_STATES = ("position", "velocity", "pressure_a", "pressure_b")


def held_out(plants: Sequence[Plant], noise: dict[str, float]) -> float:
    """Held-out error over the noise floor, as the proof has it: 70 ms, start states from the window itself."""
    squares: dict[str, list[FloatArray]] = {}
    for plant in plants:
        model = plant.model
        length = round(HORIZON / model.step)
        last = len(model.segment) - length - 20
        begins = np.unique(np.linspace(model.settle, last, WINDOWS // len(plants)).astype(np.int64))
        with np.errstate(all="ignore"):
            for name, apart in errors(plant, begins, length, noise, shooting=True).items():
                squares.setdefault(name, []).append(np.square(apart).ravel() / noise[name] ** 2)
    value = float(np.sqrt(np.mean([np.mean(np.concatenate(parts)) for parts in squares.values()])))
    return value if np.isfinite(value) else float("inf")
