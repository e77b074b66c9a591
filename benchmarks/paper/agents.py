# SPDX-License-Identifier: Apache-2.0
"""Tables training_agent and rmse: II pretrained in simulation, I trained further on the bench, III fixed (90, 15).

Authority *paper* (K_p to 90, K_i to 15) and *wide* (to 300, 100). II is `pretrain` on the shipped model; I goes on
from it on the bench, the emulator's truth, as `trainer` does, without a clock: the same samples to the bit. No filter,
the bumpless integral, the mean action of the best policy of the run's own examinations, which for I include the one
before its first episode; and of I's last policy, which the paper may mean. Sines of 300 N, each from rest: 2 s to
settle, then at least four periods; one noise seed for each training seed.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.controllers import PAPER_GAINS, policy_of
from benchmarks.paper.store import AUTHORITIES, OWN_BENCH, OWN_GAINS, PRINTED, Result, Store, truth
from benchmarks.paper.validation import corrector
from hydro_bridge.safety.guard import GuardSettings
from hydro_core.signals import SAMPLE_PERIOD, Flag
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.runs.initial_agent import InitialAgent, load_initial_agent
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings
from hydro_policy.sac.agent import actor_parameters
from hydro_policy.supervision.plant_supervisor import PlantSupervisor, learner_requirement
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.training_plan import TrainingPlan, training
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from tests.filtered_run import Corrector
from tests.offline_graph import InlineLearner, OfflineGraph

EXAMS = 8
"""Examinations of I on the bench after the first."""
CHATTER_EPISODES = 2
CHATTER_FILTERS = ("none", "paper-short", "ours")
EVALUATION = EvaluationSettings(periods=4)
"""2 s to settle, at least four periods."""


class Listening(OfflineGraph):
    """Keeps the sum of u'^2 of an armed box and how often it tripped."""

    squares, counted, trips = 0.0, 0, 0
    _last: float | None = None
    _tripped = False

    def sample(self) -> np.void:
        """See `OfflineGraph.sample`."""
        output = super().sample()
        flags, current = int(output["flags"]), float(output["valve_current"])
        if flags & Flag.ARMED and self._last is not None:
            self.squares, self.counted = self.squares + ((current - self._last) / SAMPLE_PERIOD) ** 2, self.counted + 1
        self._last = current if flags & Flag.ARMED else None
        tripped = bool(flags & Flag.TRIPPED)
        self.trips, self._tripped = self.trips + (tripped and not self._tripped), tripped
        return output

    @property
    def chatter(self) -> float:
        """RMS of u' [A/s]."""
        return float(np.sqrt(self.squares / max(self.counted, 1)))


def run(store: Store, seed: int) -> None:
    """I, II, III."""
    store.piece(f"rmse-default-III-{seed}", lambda: _rmse(store, FixedGains(*PAPER_GAINS), seed))
    for authority in AUTHORITIES:
        for who, make in (("II", _second), ("I", _first)):
            store.piece(f"rmse-default-{authority}-{who}-{seed}", partial(make, store, authority, seed))


def run_own(store: Store, seed: int) -> None:
    """On the bench with the paper's row III: III, fixed gains behind the paper's filter, II and I."""
    own = store.own
    for filtered in (False, True):
        for kp in OWN_GAINS:
            name = f"{'' if filtered else 'un'}filtered-{kp:g}-{seed}"
            own.piece(name, partial(_fixed, own, kp, seed, filtered))
    for who, make in (("II", _second), ("I", _first)):
        own.piece(f"rmse-default-paper-{who}-{seed}", partial(make, own, "paper", seed))


def _fixed(store: Store, kp: float, seed: int, filtered: bool) -> Result:
    made = corrector(store, "paper-short", seed) if filtered else None
    return _rmse(store, FixedGains(kp, PAPER_GAINS[1]), seed, made)


def run_chatter(store: Store, seed: int) -> None:
    """u' during training on the default bench without a filter, behind the paper's, and behind ours."""
    for chosen in CHATTER_FILTERS:
        store.piece(f"chatter-{chosen}-{seed}", partial(_chatter, store, chosen, seed))


def simulated(store: Store, authority: str, seed: int) -> InitialAgent:
    """II: the agent that `pretrain` makes; made again if its run is gone, gone on with if it is not finished.

    What is there of a run of another length, or of one without a checkpoint, is begun again.
    """
    folder, episodes = store.folder / f"II-{authority}-{seed}", store.size.simulated_episodes
    table, run = folder.with_suffix(".curve"), RunDirectory(folder)

    def pretrained() -> Result:
        words = ["--resume", str(folder)]
        if not (run.latest.is_dir() and run.load_settings().episodes == episodes):
            shutil.rmtree(folder, ignore_errors=True)
            steps = str(PRINTED["training_agent"]["steps"])
            words = ["--out", str(folder), "--configuration", authority, "--seed", str(seed), "--steps", steps]
            words += ["--episodes", str(episodes), *(["--model", str(OWN_BENCH)] if store.bench == "own" else [])]
        command = [sys.executable, "-m", "hydro_policy.pretraining.pretrain", *words, "--json", str(table)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return {"curve": json.loads(table.read_text(encoding="utf-8"))["rows"]}

    store.piece(folder.name, pretrained, table)
    return load_initial_agent(folder)


def _second(store: Store, authority: str, seed: int) -> Result:
    start = simulated(store, authority, seed)
    return _rmse(store, _controller(start, actor_parameters(start.agent)), seed)


def _first(store: Store, authority: str, seed: int) -> Result:
    start, episodes = simulated(store, authority, seed), store.size.bench_episodes
    session, graph = train(store, start, episodes, max(episodes // EXAMS, 1), seed)
    came = actor_parameters(start.agent)
    plan, progress = session.plan, session.plan.progress
    best, last = (came if found is None else found for found in (plan.best, plan.good))
    told = {"episodes": progress.episode, "trips": graph.trips, "ended": str(plan.abort_reason or "")}
    told |= {key: [float(exam[key]) for exam in progress.exams] for key in ("score", "error")}
    told |= {"last": _rmse(store, _controller(start, last), seed)["rmse"]}
    return {**_rmse(store, _controller(start, best), seed), **told}


def train(
    store: Store, start: InitialAgent, episodes: int, every: int, seed: int, corrector: Corrector | None = None
) -> tuple[TrialRunner[TrainingPlan], Listening]:
    """Episodes on the store's bench as `trainer` does them, examined every so many (0: never), each sine twice.

    A run that trips again and again ends after a minute for each episode, and ten more where there are examinations.
    """
    settings = start.adapt_settings(TrainingSettings(episodes=episodes, seed=seed))
    settings = replace(settings, exam=replace(settings.exam, every=every, repeats=2))
    reach = settings.task.gains
    guard = GuardSettings(delta_kp_max=reach.delta_kp_max, delta_ki_max=reach.delta_ki_max)
    plant = TruthPlant(truth(store.bench))
    graph = Listening(plant, Bench.nominal(), guard=guard, seed=seed, corrector=corrector)
    learner = InlineLearner(settings, start=start.agent)
    supervisor = PlantSupervisor(graph, True, [learner_requirement(lambda: learner.ready)])
    session = training(TrainingPlan(settings, learner, graph), supervisor)
    graph.run(session, 60.0 * episodes + (600.0 if every else 0.0), learner)
    return session, graph


def _controller(start: InitialAgent, parameters: Any) -> PolicyController:
    return PolicyController(policy_of(parameters, start), start.gains, "policy")


def _rmse(store: Store, controller: Controller, seed: int, corrector: Corrector | None = None) -> Result:
    """Force RMSE [N] at the paper's sines, each from rest; NaN: stopped."""
    guard = GuardSettings(delta_kp_max=285.0, delta_ki_max=95.0)
    plant, found = TruthPlant(truth(store.bench)), []
    for frequency in PRINTED["rmse"]["frequencies"]:
        graph = OfflineGraph(plant, Bench.nominal(), guard=guard, seed=1000 + seed, corrector=corrector)
        plan = Comparison(replace(EVALUATION, frequencies=(float(frequency),)), [controller])
        session = TrialRunner(plan, PlantSupervisor(graph, True))
        graph.run(session, 10.0 * plan.seconds)
        found += [score.rmse for score in session.scores]
    return {"rmse": found}


def _chatter(store: Store, chosen: str, seed: int) -> Result:
    start = simulated(store, "paper", seed)
    made = None if chosen == "none" else corrector(store, chosen, seed)
    session, graph = train(store, start, CHATTER_EPISODES, 0, seed, made)
    return {"chatter": graph.chatter, "trips": graph.trips, "episodes": session.plan.progress.episode}
