# SPDX-License-Identifier: Apache-2.0
"""Pretraining: the learner of the bench (`learner_process.learner`) on vectorised simulated benches, in one process.

::

    round     one episode on every bench, all from rest, references as in `trainer`
    step      all benches act, ten samples pass, transitions are stored, the pending updates are made
    after     examination of the mean action on four sines of 300 N, for the learning curve and the best policy;
              with drawn benches also on eight held-out ones

A round's references, benches and noise follow from the seed and the episode's number alone, so that an interrupted and
resumed run ends with the same weights as an uninterrupted one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hydro_core.settings import check, quantity
from hydro_core.signals import FloatArray
from hydro_policy.envs import FilterName, vector_runs
from hydro_policy.envs.environment import Environment, Episodes, Transitions
from hydro_policy.envs.vector_env import VectorBench, vector_filter
from hydro_policy.envs.vector_runs import VectorController
from hydro_policy.learner_process.learner import Learner
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings
from hydro_policy.sac.agent import Agent
from hydro_policy.sac.policy import Policy
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE, events
from hydro_policy.task.mdp.events import Randomisation, RandomisedBench
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench

REFERENCE_GAINS = (90.0, 15.0)  # K_p, K_i of the paper's controller III, which scores are relative to

COMPLETION_SHARE_MIN = 0.02
"""Smallest share of drawn benches on which the reference gains do not trip, since scores are relative to them."""

TRIPPED_SCORE = 10.0  # score of a run in which the box trips, in RMSE of the reference gains


@dataclass(frozen=True, kw_only=True)
class PretrainSettings:
    """Settings of a pretraining: those of the training, and those of the simulation."""

    training: TrainingSettings = field(default_factory=TrainingSettings)
    benches: Annotated[int, quantity("-", 1, 256)] = 8
    """Benches side by side; each plays its share of the episodes."""
    randomisation: Randomisation | None = None
    """None: the same bench always."""
    examined: Annotated[int, quantity("-", 0, 256)] = 8
    """Drawn benches that a policy is examined on besides the known one, if benches are drawn."""
    filter: FilterName = "none"
    """The filter between policy and box: none, learned (`vector_filter`)."""
    box: BoxConfig = field(default_factory=BoxConfig)
    """Base gains, limits and form of the integral of the boxes."""
    evaluation: EvaluationSettings = field(default_factory=EvaluationSettings)

    def __post_init__(self) -> None:
        check(self)


class Pretraining:
    """Pretraining of a policy on vectorised simulated benches: learner and results.

    `settings`: see `PretrainSettings`. `source`: simulated bench. `box_bench`: bench assumed by the box. `run`: its
    folder, begun by `write_run`, from whose latest checkpoint it goes on; None: in memory.
    """

    def __init__(
        self, settings: PretrainSettings, source: Bench, box_bench: Bench, run: RunDirectory | None = None
    ) -> None:
        self.settings, self._box_bench = settings, box_bench
        self._episodes = Episodes(source=source, box_bench=box_bench, randomisation=settings.randomisation)
        training = settings.training
        self.vector_bench = self._make_vector_bench(settings.benches)
        self.environment = Environment(self.vector_bench, training.task)
        start = None if run else Agent(OBSERVATION_SIZE, ACTION_SIZE, training.sac).dump()
        self.learner = Learner(training, run or RunDirectory(Path()), start)
        self.policy = Policy(training.sac, training.task.size)
        self.policy.load_flat(self.learner.sac.actor_parameters())
        self.rng = np.random.default_rng(training.seed)
        self.episode = 0  # episodes finished
        self.history: list[dict[str, Any]] = []
        """One entry per round: episode, mean return, trips, RMSE at each frequency, scores."""
        self.best_score = math.inf
        if state := self.learner.acting_state:
            self.episode, self.history, self.best_score = state["episode"], state["history"], state["best_score"]
            self.rng.bit_generator.state = state["random_state"]
        self._examined: list[RandomisedBench | None] = [None]  # the known bench, then drawn ones
        fixed = vector_runs.fixed_gains(np.array(REFERENCE_GAINS), (settings.box.base_kp, settings.box.base_ki))
        known = self.rmse(fixed, self._examined)
        self._reference = np.where(np.isnan(known), settings.evaluation.amplitude / math.sqrt(2.0), known)
        if settings.randomisation is not None:
            self._draw_examined(fixed, settings.randomisation)
        self.reference_rmse: FloatArray = self._reference[0]
        """RMSE of the reference gains on the known bench [N], shape (cases,); where they trip, the RMS of a sine."""

    @property
    def finished(self) -> bool:
        """Whether all episodes are done."""
        return self.episode >= self.settings.training.episodes

    def run_round(self, each_step: Callable[[Transitions], object] = lambda transitions: None) -> dict[str, Any]:
        """Run one episode on every bench; returns the new entry of `history`."""
        training, learner = self.settings.training, self.learner
        count = min(len(self.vector_bench), training.episodes - self.episode)
        numbers = range(self.episode, self.episode + len(self.vector_bench))
        references = [
            self._episodes.install(
                self.vector_bench, index, events.reference(training.task, number, training.seed), number, training.seed
            )
            for index, number in enumerate(numbers)
        ]
        seeds = [events.stream_seed(training.seed, number, events.NOISE_STREAM) for number in numbers]
        observation = self.environment.reset(references, seeds)
        returns, squares, trips = np.zeros(len(self.vector_bench)), 0.0, 0
        for _ in range(training.task.steps_per_episode):
            transitions = self.environment.step(self.policy.act(observation, self.rng))
            observation = self.environment.observation
            learner.replay.extend(transitions.rows(count))
            if learner.work(learner.pending_updates):
                self.policy.load_flat(learner.sac.actor_parameters())
            returns += transitions.reward
            error = transitions.samples["reference_force"][:count] - transitions.samples["load_force"][:count]
            squares += float(np.mean(error * error)) / training.task.steps_per_episode
            trips += int(transitions.terminated[:count].sum())
            each_step(transitions)
        self.episode += count
        self.examine(float(returns[:count].mean()), math.sqrt(squares), trips)
        return self.history[-1]

    def save(self, notes: Mapping[str, object]) -> None:
        """Write a checkpoint, from which `Pretraining` goes on; `notes` go into the policy's file."""
        state = {"episode": self.episode, "history": self.history, "best_score": self.best_score, "notes": notes}
        self.learner.handle("save", {**state, "random_state": self.rng.bit_generator.state})

    def examine(self, mean_return: float = math.nan, force_rmse: float = math.nan, trips: int = 0) -> None:
        """Evaluate the policy's mean action; adds an entry to `history`, and updates the best agent."""
        rmse = self.rmse(
            vector_runs.VectorPolicyController(self.policy, self.settings.training.task.gains), self._examined
        )
        ratio = np.where(np.isnan(rmse), TRIPPED_SCORE, rmse / self._reference)
        score, sac = float(ratio.mean()), self.learner.sac
        if best := score < self.best_score:
            self.best_score = score
            self.learner.handle("propose", sac.updates)
            self.learner.handle("accept", True)
        self.history.append(
            {
                "episode": self.episode, "return": mean_return, "force_rmse": force_rmse, "trips": trips,
                "score": score, "changed": float(ratio[1:].mean()) if len(ratio) > 1 else None,  # on drawn benches
                "rmse": rmse[0].tolist(), "beaten": int(np.sum(rmse[0] < self.reference_rmse)), "best": best,
                "updates": sac.updates, "entropy_coefficient": sac.entropy_coefficient,
            }
        )  # fmt: skip

    def _draw_examined(self, fixed: VectorController, randomisation: Randomisation) -> None:
        """Draw the held-out benches of the examinations, only ones on which the reference gains do not trip."""
        wanted, seed = self.settings.examined, self.settings.training.seed
        for number in range(round(wanted / COMPLETION_SHARE_MIN)):
            drawn = events.stream_seed(seed, number, events.EXAM_STREAM)
            bench = events.draw_bench(randomisation, self._episodes.source, drawn)
            rmse = self.rmse(fixed, [bench])
            if np.isfinite(rmse).all():
                self._examined.append(bench)
                self._reference = np.concatenate((self._reference, rmse))
            if len(self._examined) > wanted:
                return
        if wanted:
            raise ValueError(f"too few drawn benches bear the fixed gains {REFERENCE_GAINS}: draw without --randomise")

    def rmse(self, controller: VectorController, benches: Sequence[RandomisedBench | None]) -> FloatArray:
        """Return the RMSE [N] on each bench and case, NaN where the box tripped; None: the known bench."""
        evaluation = self.settings.evaluation
        played = list(evaluation.cases) * len(benches)
        vector_bench = self._make_vector_bench(len(played))
        for index, case in enumerate(played):
            bench = benches[index // len(evaluation.cases)]
            if bench is not None:
                vector_bench.replace(index, self._box_bench, bench.plant, bench.gain_delay, bench.dead_time)
                played[index] = replace(case, signal=bench.limit_amplitude(case.signal))
        rmse = vector_runs.rmse(vector_bench, played, controller, evaluation)
        return rmse.reshape(len(benches), len(evaluation.cases))

    def _make_vector_bench(self, count: int) -> VectorBench:
        filters = vector_filter(self.settings.filter, self._box_bench, count)
        plants = [self._episodes.plant() for _ in range(count)]
        return VectorBench([self._box_bench] * count, plants, self.settings.box, filters)
