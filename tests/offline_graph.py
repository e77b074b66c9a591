# SPDX-License-Identifier: Apache-2.0
"""Sessions in one process, for tests and benchmarks: box, guard, plant and learner, without ROS or real time.

Runs as fast as possible, with bit-identical results for equal seeds, unlike any real-time run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_core.signals import SAMPLE_PERIOD, STATE_FIELDS, CorrectionStatus, Law, LawCommand, ReferenceSignal
from hydro_filter.controller.loop_filter import Result
from hydro_filter.model.sample import Sample
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.runner import Session
from hydro_policy.learner_process.learner import CHUNK_UPDATES, Learner
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings
from hydro_policy.sac.agent import Agent
from hydro_policy.supervision.plant_supervisor import Outputs
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_sim.box.box import Box, BoxConfig, law_state
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant
from tests.filtered_run import Corrector

PASSED = Result(0.0, 0.0, 0.0, CorrectionStatus.PASS)
"""Result of a filter without a correction."""


class InlineLearner(LearnerSupervisor):
    """Supervisor of a learner in this process: `work` performs the pending updates, and no checkpoint is kept."""

    alive = True

    def __init__(self, settings: TrainingSettings, start: bytes | None = None) -> None:
        self.learner = Learner(
            settings, RunDirectory(Path("unused")), start or Agent(OBSERVATION_SIZE, ACTION_SIZE, settings.sac).dump()
        )
        super().__init__(settings, RunDirectory(Path("unused")))

    def _start(self) -> None:
        self.status = self.learner.status

    def _receive(self, seconds: float = 0.0) -> None:
        pass

    def _send(self, request: str, argument: Any = None, patience: float = 0.0) -> None:
        if request != "save" and self.learner.handle(request, argument):
            self.status = self.learner.status

    def check(self) -> None:
        pass

    def work(self) -> None:
        if self.learner.pending_updates >= CHUNK_UPDATES:
            while self.learner.work():
                self.status = self.learner.status


class OfflineGraph(Outputs):
    """Box, guard and plant in place of the graph: delivers samples and takes outputs synchronously.

    Parameters
    ----------
    plant, bench
        The simulated plant, and the bench assumed by the box.
    guard
        Limits of the commands.
    seed
        Seed of the plant's noise.
    corrector
        The filter; None: every sample passes. Its result of a sample acts with the next one.
    """

    def __init__(
        self,
        plant: Plant,
        bench: Bench,
        *,
        config: BoxConfig | None = None,
        guard: GuardSettings | None = None,
        seed: int = 0,
        corrector: Corrector | None = None,
    ) -> None:
        self.corrector, self.answer = corrector, PASSED
        self.box, self.plant, self.time = Box(bench, config), plant, 0.0
        self.guard = CommandGuard(settings=guard or GuardSettings())
        self.guard.set_box_law(self.box.config.compensated)
        self.sentences: list[str] = []
        self.gains_published: list[tuple[float, float, int]] = []
        self.references: list[ReferenceSignal] = []
        self._measurement = plant.reset(seed)

    def publish_gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        self.gains_published.append((delta_kp, delta_ki, step))
        self.guard.set_gains(delta_kp, delta_ki, self.time)

    def publish_law(self, command: LawCommand, step: int) -> None:
        self.guard.set_law(command, self.time)

    def publish_step(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None:
        pass

    def publish_reference(self, signal: ReferenceSignal) -> None:
        self.references.append(signal)
        self.guard.set_reference(signal)

    def arm(self, arm: bool) -> None:
        self.guard.set_arm(arm)

    def report(self, sentence: str, warning: bool = False) -> None:
        self.sentences.append(sentence)

    def sample(self) -> np.void:
        """Advance one millisecond: command in, sample out, plant step; returns the sample (`STATE_DTYPE`)."""
        sequence = int(self.box.state["sequence"][0])
        self.guard.set_correction(self.answer.delta_u, self.answer.status, sequence, self.time)
        self.box.receive(self.guard.command(self.time), self.time)
        output = self.box.tick(self._measurement, self.time)
        if self.corrector is not None:
            law = law_state(self.box.state[0])
            self.answer = self.corrector.correct(Sample.from_record(output, None if law.law is Law.PAPER else law))
        self._measurement = self.plant.step(float(output["valve_current"]))
        self.time += SAMPLE_PERIOD
        return output

    def run(
        self,
        session: Session,
        seconds: float,
        learner: InlineLearner | None = None,
        compensation: LiveCompensation | None = None,
    ) -> None:
        """Drive `session` until it is finished or `seconds` of bench time are over; `compensation` hears the law."""
        end = self.time + seconds - 0.5 * SAMPLE_PERIOD
        tick = 0
        while self.time < end and not session.finished:
            record = self.sample()
            values = np.array([record[name] for name in STATE_FIELDS])
            session.on_correction(self.answer.after, self.answer.status)
            law = law_state(self.box.state[0])
            if compensation is not None and law.law is not Law.PAPER:
                compensation.on_law_state(int(record["sequence"]), law.law, law.compensated_reference)
            stepped = session.on_sample(int(record["sequence"]), values, int(record["flags"]), self.time)
            if stepped and learner is not None:
                learner.work()
            if tick % 50 == 0:
                session.on_tick(self.time)
            tick += 1
