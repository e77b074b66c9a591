# SPDX-License-Identifier: Apache-2.0
"""What benchmarks of the learned bench share: recordings of one truth, structures trained on them, errors held out."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray, matrix
from hydro_sim.emulator import jobs
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import recordings
from hydro_sim.files.recordings import Data
from hydro_sim.identification import adam, evaluation, stages, training
from hydro_sim.identification.evaluation import Predictor, Scored
from hydro_sim.learned.model import Learned, Model
from hydro_sim.model.bench import Bench
from hydro_sim.neural import mlp
from hydro_sim.structured import rollout
from hydro_sim.structured.model import StructuredModel

TRAINING, VALIDATION, HELD_OUT = (11, 12), 13, 21
"""Seeds of the schedules and of the noise."""
HORIZON, STRIDE = 70, 37


@dataclass(frozen=True, kw_only=True)
class Row:
    """A structure of the table."""

    structure: str
    hidden: tuple[int, ...] = ()
    """Widths of the hidden layers; none: the structured model without a network."""

    @property
    def name(self) -> str:
        """In the table and in file names: structured-2x32."""
        return f"{self.structure}-{len(self.hidden)}x{self.hidden[0]}" if self.hidden else f"{self.structure}-alone"


ALONE = Row(structure="structured")
"""Its constants and its observer serve the others."""


class Case:
    """Recordings of one truth, and what is found on them."""

    def __init__(self, folder: Path, truth: str | None, epochs: int) -> None:
        self.folder, self.truth, self.epochs = folder, truth, epochs

    def record(self, seconds: float, seed: int) -> Recording:
        """A run of the emulator under the schedule of a seed."""
        segments = draw(seconds, seed)
        return record_offline(jobs.truth(self.truth), segments, seed=seed)

    @cache  # noqa: B019 (one case a process)
    def data(self) -> Data:
        """What every structure is trained on."""
        states = {f"train{seed}": self.record(150.0, seed).states for seed in TRAINING}
        return recordings.split({**states, f"train{VALIDATION}": self.record(60.0, VALIDATION).states})

    @cache  # noqa: B019
    def held_out(self) -> list[Scored]:
        """What every structure is judged by."""
        recording = self.record(60.0, HELD_OUT)
        truth = matrix(recording.noise_free)
        runs = recordings.runs("held out", recording.states)
        return [Scored(run=run, truth=truth[run.first : run.first + len(run)]) for run in runs]

    def model(self, row: Row) -> Path:
        """Where a row's weights lie."""
        return self.folder / f"{row.name}.safetensors"

    def train(self, row: Row) -> None:
        """Train a row and keep its weights, with the facts of the training."""
        began = time.process_time()
        data, settings = self.data(), self.settings(row)
        model, spent = self.start(row, data, settings)
        facts: dict[str, Any] = {"weights": int(model.flat.size) if row.hidden else 0, "epochs": 0, "best_epoch": 0}
        for last, best in training.steps(model, data, settings) if row.hidden else ():
            show = f"{row.name}: epoch {last.epoch}, validation {last.best_error:.5f} at epoch {last.best_epoch}"
            print(show, file=sys.stderr, end="\r")
            model, facts["epochs"], facts["best_epoch"] = best, last.epoch, last.best_epoch
        if isinstance(model, StructuredModel):
            model = stages.tune_observer(model, data)
        facts["cpu"] = round(spent + time.process_time() - began, 1)
        training.finished(model, data, facts).save(self.model(row))

    def start(self, row: Row, data: Data, settings: training.Settings) -> tuple[Model, float]:
        """The model before its network is trained, and CPU spent on that [s]: constants are identified once for all."""
        if row.structure != "structured":
            return training.start(data, settings, Bench.nominal()), 0.0
        if row == ALONE:
            model = training.start(data, settings, Bench.nominal())
            assert isinstance(model, StructuredModel)
            say = partial(print, file=sys.stderr)
            return stages.fit_constants(model, data, settings.identify_windows, settings.seed, say), 0.0
        found = Learned.load(self.model(ALONE))
        assert isinstance(found.model, StructuredModel)
        width = row.hidden[0], row.hidden[1]
        flat = mlp.initial(np.random.default_rng(0), rollout.INPUTS, width, rollout.OUTPUTS, last=0.0)
        return replace(found.model, flat=flat, hidden=width), float(found.training["cpu"])

    def settings(self, row: Row) -> training.Settings:
        """The same for all but for what the command's own defaults tell apart: learning rate and patience."""
        fixed = row.structure == "structured"
        loop = training.STRUCTURED_ADAM if fixed else adam.Settings()
        loop = replace(loop, epochs=self.epochs, patience=20 if fixed else 60)
        return training.Settings(structure=row.structure, hidden=row.hidden or (32, 32), batch=1024, adam=loop)

    @cache  # noqa: B019
    def observer(self) -> StructuredModel:
        """The structured model without a network."""
        model = Learned.load(self.model(ALONE)).model
        assert isinstance(model, StructuredModel)
        return model

    @cache  # noqa: B019
    def observed(self) -> list[FloatArray]:
        """x by its observer at the samples of the held-out runs: a network's starts, most of the noise gone."""
        found, c, reading = [], self.observer().compiled[0], np.empty(rollout.READINGS)
        for item in self.held_out():
            x = np.empty((len(item.run), 8))
            for k, full in enumerate(self.observer().estimate(item.run)):
                rollout.read(c, full[: rollout.STATES], reading)
                rollout.show(reading, full[rollout.STATES :], x[k])
            found.append(x)
        return found

    def errors(self, model: Predictor, states: list[FloatArray], *, recorded: bool = False) -> FloatArray:
        """RMSE of predictions from states, against the noise-free log or the recording, shape (8,), SI units."""
        how: dict[str, Any] = {"recorded": recorded, "horizon": HORIZON, "stride": STRIDE}
        return evaluation.prediction_errors(model, states, self.held_out(), **how).rmse
