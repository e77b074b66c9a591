# SPDX-License-Identifier: Apache-2.0
"""Results of a training: comparison with other controllers, timing, files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydro_policy.evaluation import report as evaluation
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings
from hydro_policy.nodes.evaluation.results import write_page
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.runs import report as training
from hydro_policy.runs.initial_agent import AGENT, InitialAgent
from hydro_policy.runs.record import RunRecord
from hydro_policy.runs.run import RunDirectory
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.sessions.training import TrainingSession

SEARCHED = EvaluationSettings(frequencies=(1.0, 2.0))
"""References of the search for the best fixed gains."""


def paper_controllers(session: TrainingSession, start: InitialAgent | None) -> list[Controller]:
    """Return the paper's controllers: I trained on the bench, II pretrained, III fixed; without II the base gains.

    I is the best policy of the run, or the last one if none was better than the initial one.
    """
    gains, best = session.settings.task.gains, session.keeper.best
    name = "I: last policy, trained here"
    if best is not None and trained_a_better_one(session):
        session.policy.load_flat(best)
        name = "I: policy, trained here"
    controllers: list[Controller] = [PolicyController(session.policy, gains, name)]
    if start is not None:
        before = Policy(start.sac.hidden_size)
        before.load_flat(actor_parameters(start.agent))
        controllers.append(PolicyController(before, gains, "II: policy it started from"))
    base = session.settings.base_gains
    controllers.append(FixedGains(90.0, 15.0, base))
    return controllers if start is not None else [*controllers, FixedGains(15.0, 5.0, base)]


def trained_a_better_one(session: TrainingSession) -> bool:
    """Return whether a policy trained here scored better than the initial one, by more than noise."""
    return any(exam["best"] and exam["episode"] > 0 for exam in session.progress.exams)


def timing(node: GraphNode, session: TrainingSession) -> dict[str, float]:
    """Return percentiles [s] of the timings reported in results.md."""
    measured = {"jitter": node.timing.jitter, "inference": session.explorer.inference, "response": node.timing.response}
    return {f"{name}_p99": latency.percentile(99) for name, latency in measured.items()}


def write_training_page(
    run: RunDirectory, record: RunRecord, results: EvaluationSession | None, notes: Mapping[str, Any]
) -> None:
    """Write learning.png and report.html into the run's folder; a failure is reported, never raised."""
    found = evaluation.sections(results, run.tracking_plot) if results is not None and results.scores else []
    try:
        training.draw_curve(record.events, run.learning_curve)
    except OSError as error:
        print(f"no learning curve: {error.strerror or error}", file=sys.stderr)
    told = training.sections(record.events, run.learning_curve)
    write_page(run, f"Training {run.path.name}", notes, found + told)


def print_files(
    run: RunDirectory, recording: Path | None, finished: bool, options: argparse.Namespace, seconds: float
) -> None:
    """Print where each file is and what to run next."""
    listed = [
        ("policy", run.policy),
        ("checkpoint", run.latest),
        ("best agent", run.best / AGENT),
        ("what happened", run.record),
        ("recording", recording),
        ("evaluation", run.evaluation),
        ("tracking plot", run.tracking_plot),
        ("page of the run", run.page),
        ("log", run.log),
    ]
    print(f"\n{'Done' if finished else 'Ended early'} after {seconds:.0f} s. Files:")
    for name, path in listed:
        if path is not None and path.exists():
            print(f"  {name:22s} {path}")
    plant = f"--plant {options.plant}" + (f" --port {options.port}" if options.port else "")
    print("Next:")
    if not finished and run.latest.exists():
        print(f"  go on            ros2 run hydro_policy trainer {plant} --resume {run.path}")
    print(f"  full training    ros2 run hydro_policy trainer {plant} --resume {run.path} --episodes 160 --evaluate")
    print(f"  compare again    ros2 run hydro_policy evaluate {plant} --policy {run.path} --fixed 90 15 --fixed 15 5")
