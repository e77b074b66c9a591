# SPDX-License-Identifier: Apache-2.0
"""Sessions on the real box and a simulated bench."""

from __future__ import annotations

import pytest
import torch

from hydro_bridge.safety.guard import GuardSettings
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.pretraining.training import PretrainSettings
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.sac.settings import SacSettings
from hydro_policy.supervision.plant_supervisor import PlantSupervisor, learner_requirement
from hydro_policy.task.cases import EvaluationSettings, ExamSettings
from hydro_policy.task.mdp import GainRange, TaskSettings
from hydro_policy.training_plan import TrainingPlan, training
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import InlineLearner, OfflineGraph

torch.set_num_threads(1)  # at these sizes more only wait for each other

BENCH = Bench.nominal()


@pytest.fixture
def compare():
    """Compare controllers, or fixed gains, over half a second of 2 Hz on the nominal bench: graph and session."""

    def make(
        *controllers, graph=None, config=None, override=None, monitor=None, compensation=None, record=None, **more
    ):
        settings = EvaluationSettings(**{"frequencies": (2.0,), "settle": 0.5, "measure": 0.5, **more})
        plan = Comparison(settings, [FixedGains(*each) if isinstance(each, tuple) else each for each in controllers])
        graph = graph or OfflineGraph(AnalyticPlant(BENCH), BENCH, config=config)
        supervisor = PlantSupervisor(graph, True, override=override)
        return graph, TrialRunner(plan, supervisor, monitor=monitor, compensation=compensation, record=record)

    return make


@pytest.fixture
def train():
    """Train for two short episodes without examinations, K_p up to 90 on the nominal bench: graph, learner, session."""

    def make(*, bench=BENCH, config=None, record=None, top=75.0, amplitude_min=200.0, **more):
        task = TaskSettings(steps_per_episode=150, amplitude_min=amplitude_min, gains=GainRange(delta_kp_max=top))
        usual = {"episodes": 2, "exam": ExamSettings(every=0), "learning_starts": 50, "replay_capacity": 4000}
        settings = TrainingSettings(task=task, sac=SacSettings(batch_size=32), **usual | more)
        guard = GuardSettings(delta_kp_max=top)
        graph, learner = OfflineGraph(AnalyticPlant(bench), bench, config=config, guard=guard), InlineLearner(settings)
        supervisor = PlantSupervisor(graph, True, [learner_requirement(lambda: learner.ready)])
        return graph, learner, training(TrainingPlan(settings, learner, graph, record=record), supervisor)

    return make


@pytest.fixture
def pretraining() -> PretrainSettings:
    """Four episodes of 0.6 s on two benches, examined at 2 Hz."""
    task, sac = TaskSettings(steps_per_episode=60), SacSettings(batch_size=32)
    training = TrainingSettings(episodes=4, learning_starts=40, replay_capacity=2000, task=task, sac=sac)
    evaluation = EvaluationSettings(frequencies=(2.0,), settle=0.5, measure=0.5)
    return PretrainSettings(training=training, benches=2, evaluation=evaluation)
