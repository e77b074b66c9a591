# SPDX-License-Identifier: Apache-2.0
"""Reinforcement-learning environment on vectorised simulated benches, without the interruptions of a ROS graph.

Observations, rewards and gains are those of a training on a live bench (`task.mdp`); each episode starts from rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_core.bench_scales import rescale
from hydro_core.signals import STATE_FIELDS, FloatArray, Law, ReferenceSignal, StateArray
from hydro_policy.compensation.estimator import Compensator, CompensatorSettings
from hydro_policy.compensation.residual import AdaptedLaw
from hydro_policy.envs.vector_env import VectorBench, records
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE, TaskSettings, events, observe, rewards, terminations
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Domain randomisation: the bench of each episode, as a function of seed and episode number."""

    source: Bench  # simulated bench
    box_bench: Bench  # bench that the boxes assume
    randomisation: events.Randomisation | None = None  # none: always the simulated bench

    def plant(self) -> AnalyticPlant:
        """Return a new plant of the simulated bench."""
        return AnalyticPlant(self.source, settings=Sensors.of_size(self.source.size))

    def install(
        self, vector_bench: VectorBench, index: int, reference: ReferenceSignal, episode: int, seed: int
    ) -> ReferenceSignal:
        """Install an episode's bench at `index`; returns the reference, limited to that bench's force range.

        `seed`: seed of the run, from which the bench is drawn, as `reference` was.
        """
        if self.randomisation is None:
            return reference
        if np.random.default_rng((seed, episode, events.KNOWN_STREAM)).random() < self.randomisation.known_share:
            vector_bench.replace(index, self.box_bench, self.plant())
            return reference
        bench_seed = events.stream_seed(seed, episode, events.BENCH_STREAM)
        drawn = events.draw_bench(self.randomisation, self.source, bench_seed)
        vector_bench.replace(index, self.box_bench, drawn.plant, drawn.gain_delay, drawn.dead_time)
        return drawn.limit_amplitude(reference)


@dataclass(frozen=True)
class Transitions:
    """Transitions of one policy step of all benches; first axis: bench."""

    observation: FloatArray  # observations acted upon, shape (n, 13)
    action: FloatArray  # shape (n, 2)
    reward: FloatArray  # shape (n,)
    next_observation: FloatArray  # next observations, shape (n, 13)
    terminated: npt.NDArray[np.bool_]  # whether the box tripped, shape (n,)
    samples: StateArray  # the ten samples, shape (n, 10)

    def rows(self, count: int | None = None) -> npt.NDArray[np.float32]:
        """Return the finite transitions of the first `count` benches (all) as rows of the replay buffer, (m, width)."""
        last = np.stack((self.reward, self.terminated), axis=1)
        rows = np.concatenate((self.observation, self.next_observation, self.action, last), axis=1)[:count]
        return rows[np.isfinite(rows).all(axis=1)].astype(np.float32)


class Environment:
    """Environment of n simulated benches: observations, rewards and terminations of their policy steps.

    `vector_bench`: the benches. `task`: observation, reward, gains. `law`: force law of the boxes; coefficients of the
    compensated law are estimated online for each bench.
    """

    def __init__(self, vector_bench: VectorBench, task: TaskSettings, law: Law = Law.PAPER) -> None:
        self.vector_bench, self.task, self.law = vector_bench, task, law
        self.observation: FloatArray = np.zeros((len(vector_bench), OBSERVATION_SIZE))
        """Observations to act upon, shape (n, 13)."""
        self._references = [ReferenceSignal()] * len(vector_bench)
        self._seeds: npt.NDArray[np.int64] = np.zeros(len(vector_bench), np.int64)
        self._adapted: AdaptedLaw | None = None
        if law is Law.COMPENSATED:
            settings = rescale(CompensatorSettings(), NOMINAL, task.size)
            self._adapted = AdaptedLaw(Compensator(len(vector_bench), settings, vector_bench.config.compensated))

    def reset(self, references: Sequence[ReferenceSignal], seeds: Sequence[int]) -> FloatArray:
        """Start a new episode on every bench, from rest; returns the observations, shape (n, 13)."""
        for index, (reference, seed) in enumerate(zip(references, seeds, strict=True)):
            self.reset_one(index, reference, int(seed))
        return self.observation

    def reset_one(self, index: int, reference: ReferenceSignal, seed: int) -> None:
        """Start a new episode on bench `index`, from rest."""
        self._references[index], self._seeds[index] = reference, seed
        self.vector_bench.reset(index, reference, seed, law=self.law)
        if self._adapted is not None:
            self._adapted.estimator.reset(index)
        first = records(self.vector_bench.samples[index, -1], STATE_FIELDS)
        self.observation[index] = observe(first, np.zeros(ACTION_SIZE), self.task.size)

    def step(self, actions: FloatArray, *, restart: bool = True) -> Transitions:
        """Advance ten samples under `actions`, shape (n, 2); `restart`: restart the episode of tripped benches."""
        before = self.observation
        samples = self.vector_bench.step_adapted(self.task.gains.changes(actions), self._adapted).copy()
        error = samples["reference_force"] - samples["load_force"]
        error_rate = samples["reference_force_rate"] - samples["load_force_rate"]
        tripped = terminations.tripped(samples["flags"][:, -1])
        reward = np.where(tripped, rewards.trip(self.task), rewards.tracking(self.task, error, error_rate))
        next_observation = observe(records(samples[:, -1], STATE_FIELDS), actions, self.task.size)
        unknown = tripped & ~np.isfinite(next_observation).all(axis=1)
        next_observation[unknown] = before[unknown]  # terminal: its value is not used
        self.observation = next_observation.copy()
        for index in np.flatnonzero(tripped) if restart else ():
            self.reset_one(int(index), self._references[index], int(self._seeds[index]) + 1)
        return Transitions(before, actions, reward, next_observation, tripped, samples)
