# SPDX-License-Identifier: Apache-2.0
"""What training on the bench adds, on the emulated one and on benches that changed: results.md's tables of many seeds.

Everything runs on the emulator's plant without clock or serial line: the same samples to the bit, many times as fast.

I    trained on this bench for a few episodes, from an agent given; one policy for each training seed
II   that agent as it was pretrained in simulation
III  fixed (90, 15), the paper's
IV   the best fixed gains of a grid on the nominal (default) bench; IV* of a grid on the bench at hand

Each is measured with every noise seed on every reference; a cell is mean and standard deviation over training seeds
(I) or noise seeds. The filter is not in the loop: where it matters is said in safety.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks._truth_fleet import truth_fleet
from benchmarks.controllers import SHIPPED, mean_action
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.signals import FloatArray
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_runs import Chooser
from hydro_policy.evaluation.gain_search import Gains, GridSearch, GridSettings
from hydro_policy.runs.initial_agent import InitialAgent, load_initial_agent
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.sessions.offline import InlineLearner, OfflineGraph
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.emulator.truth.config import TruthConfig, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench

PAPER_III = (90.0, 15.0)
BENCHES: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "spring 10 kN/m": {"spring_stiffness": {"ratio": 0.5}},
    "spring 14 kN/m": {"spring_stiffness": {"ratio": 0.7}},
    "spring 28 kN/m": {"spring_stiffness": {"ratio": 1.4}},
    "spring 40 kN/m": {"spring_stiffness": {"ratio": 2.0}},
    "spring 50 kN/m": {"spring_stiffness": {"ratio": 2.5}},
    "supply 13 MPa": {"supply_pressure": {"ratio": 0.8125}},
    "supply 10 MPa": {"supply_pressure": {"ratio": 0.625}},
    "dry friction +30 N": {"friction_coulomb": {"form": "lugre", "force": 42.0}},
    "air 1 %": {"entrained_air": {"volume_fraction": 0.01}},
    "valve gain -25 %": {"valve_gain": {"ratio": 0.75}},
    "cell 18 Hz": {"sensor_lag": {"bandwidth": 18.0, "damping": 0.55}},
}
"""What is changed in the emulator's default truth; keys of truth.md's effects."""

Controllers = dict[str, Callable[[], Chooser]]


def bench(name: str) -> TruthConfig:
    """A truth of `BENCHES`."""
    return truth_from_mapping({"profile": "default", "effects": dict(BENCHES[name])})


def train(
    config: TruthConfig, start: InitialAgent, episodes: int, seed: int, updates: float
) -> tuple[FloatArray, dict[str, Any]]:
    """I: some episodes on this bench as `trainer` would do them; the best policy's parameters, and progress."""
    settings = start.adopted(TrainingSettings(episodes=episodes, seed=seed, updates_per_step=updates))
    settings = replace(settings, exam=replace(settings.exam, every=2))
    reach = settings.task.gains
    guard = GuardSettings(delta_kp_max=reach.delta_kp_max, delta_ki_max=reach.delta_ki_max)
    graph = OfflineGraph(TruthPlant(config), Bench.nominal(), guard=guard, seed=seed)
    learner = InlineLearner(settings, start=start.agent)
    session = TrainingSession(settings, learner, graph)
    graph.run(session, 60.0 * episodes + 120.0, learner)
    best = session.run.best
    assert best is not None
    done = session.progress
    told = {"exams": done.exams, "passed_at": done.passed_at, "rollbacks": done.rollbacks, "ended": session.run.gave_up}
    return best, {"seed": seed, "trips": done.interruptions, **told}


def search(config: TruthConfig, settings: GridSettings, evaluation: EvaluationSettings) -> GridSearch:
    """The grid of `evaluate --grid`, its runs side by side."""
    found, short = GridSearch(settings), replace(evaluation, settle=1.0, measure=2.0, periods=1)
    while (pair := found.next()) is not None:
        found.tell(pair, measured(config, short, lambda pair=pair: vector_runs.fixed(np.array(pair)), 0))
    return found


def measured(config: TruthConfig, evaluation: EvaluationSettings, make: Callable[[], Chooser], seed: int) -> FloatArray:
    """RMSE [N] on each case; NaN: tripped."""
    cases = evaluation.cases
    return vector_runs.rmse(truth_fleet(len(cases), config), cases, make(), evaluation, seed)


def compare(name: str, controllers: Controllers, evaluation: EvaluationSettings, seeds: int) -> dict[str, FloatArray]:
    """RMSE [N] of each controller, shape (seeds, cases)."""
    config = bench(name)
    return {
        who: np.array([measured(config, evaluation, make, seed) for seed in range(seeds)])
        for who, make in controllers.items()
    }


def cell(values: FloatArray) -> str:
    """Mean and standard deviation, or how many tripped."""
    tripped = int(np.isnan(values).sum())
    if tripped:
        return f"tripped {tripped}/{values.size}"
    return f"{values.mean():.1f} ± {values.std(ddof=1):.1f}" if values.size > 1 else f"{values.mean():.1f}"


def add_rows(table: Table, name: str, rmse: Mapping[str, FloatArray], cases: list[str]) -> None:
    """One row for each controller; those of I are one, over all training seeds."""
    groups: dict[str, list[FloatArray]] = {}
    for who, values in rmse.items():
        groups.setdefault(who.split("#")[0], []).append(values)
    for who, parts in groups.items():
        values = np.array([part.mean(axis=0) for part in parts]) if len(parts) > 1 else parts[0]
        table.add(bench=name, controller=who, **{case: cell(values[:, k]) for k, case in enumerate(cases)})


def fixed(pair: Gains) -> Callable[[], Chooser]:
    """Fixed gains."""
    return lambda: vector_runs.fixed(np.array(pair))


def run(asked: argparse.Namespace) -> Table:
    """Train, search, compare."""
    evaluation = EvaluationSettings(periods=4, multisine=True, steps=True)
    sines = replace(evaluation, multisine=False, steps=False)
    cases = [case.name for case in evaluation.cases]
    starts = {path.name: load_initial_agent(path) for path in asked.start}
    limits = GridSettings() if asked.kp_max is None else GridSettings(kp_max=asked.kp_max, ki_max=asked.ki_max)
    nominal = search(bench("default"), limits, sines)
    table = Table(
        {"bench": "", "controller": "", **dict.fromkeys(cases, "N")}, title=f"Force RMSE [N], {asked.seeds} seeds"
    )
    bar = progress(total=len(asked.benches), label="benches", unit="bench")
    for name in asked.benches:
        controllers: Controllers = {}
        for source, start in starts.items():
            for seed in range(asked.training_seeds):
                trained, told = train(bench(name), start, asked.episodes, seed, asked.updates_per_step)
                controllers[f"I {source}, trained here #{seed}"] = partial(mean_action, trained, start)
                print(f"{name}, {source}, training seed {seed}: {_told(told)}", file=sys.stderr, flush=True)
            controllers[f"II {source}, simulation only"] = partial(mean_action, actor_parameters(start.agent), start)
        controllers["III fixed (90, 15)"] = fixed(PAPER_III)
        controllers[f"IV fixed {_pair(nominal.best)}"] = fixed(nominal.best)
        if name != "default":
            here = search(bench(name), limits, sines).best
            controllers[f"IV* fixed {_pair(here)}, best here"] = fixed(here)
        else:
            for case, pair in zip(sines.cases, nominal.best_each, strict=True):
                print(f"best fixed gains at {case.name}: {_pair(pair)}", file=sys.stderr)
        add_rows(table, name, compare(name, controllers, evaluation, asked.seeds), cases)
        bar.update()
    bar.close()
    return table


def _pair(pair: Gains) -> str:
    return f"({pair[0]:g}, {pair[1]:g})"


def _told(told: Mapping[str, Any]) -> str:
    scores = " ".join(f"{exam['score']:.3f}" for exam in told["exams"])
    passed = f"beats III everywhere after {told['passed_at']} episodes" if told["passed_at"] >= 0 else "never beats III"
    return f"scores {scores}; {passed}; {told['rollbacks']} rollbacks{', ' + told['ended'] if told['ended'] else ''}"


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.trained_controllers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--start", type=Path, nargs="+", default=[SHIPPED], metavar="RUN", help="pretrained agents")
    names = ", ".join(BENCHES).replace("%", "%%")
    parser.add_argument("--benches", nargs="+", default=["default"], choices=BENCHES, metavar="NAME", help=names)
    parser.add_argument("--seeds", type=int, default=5, help="of noise, default 5")
    parser.add_argument("--training-seeds", type=int, default=5, help="policies I, default 5")
    parser.add_argument("--episodes", type=int, default=6, help="of I, default 6")
    parser.add_argument("--updates-per-step", type=float, default=1.0, help="of I, default 1")
    parser.add_argument("--kp-max", type=float, help="of the grid; default 300")
    parser.add_argument("--ki-max", type=float, default=100.0, help="of the grid; default 100")
    add_json_argument(parser)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    run(asked).show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
