# SPDX-License-Identifier: Apache-2.0
"""What the form of the law's integral does (docs/decisions/0031-bumpless-integral.md), on the emulated bench's truth.

tracking      300 N sines as `evaluate` plays them
interrupted   the same, base gains for 0.1 s in every second: late commands, an override, a rollback
waited        armed for a while at 0 N under base gains, then the controller: its first seconds
fresh         the same without the wait

Each under both forms, without a filter and behind the learned one. `rate` and `worst` are what the trainer's monitor
calls chattering: RMS of u' over the whole part, and in the median step of the worst 0.1 s; `monitor` is its first
verdict.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np

from benchmarks._truth_fleet import truth_fleet
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_FIELDS,
    Command,
    FloatArray,
    ReferenceSignal,
    StateArray,
)
from hydro_policy.envs import vector_runs
from hydro_policy.envs.filter_kinds import FILTERS
from hydro_policy.envs.vector_env import VectorBench, records
from hydro_policy.envs.vector_filter import fleet_filter
from hydro_policy.envs.vector_runs import Chooser, PolicyChooser
from hydro_policy.sac.policy import load_policy
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import ACTIONS
from hydro_policy.task.step_aggregator import StepClock
from hydro_sim.box.box import BoxConfig, Integral, fill_command
from hydro_sim.model.bench import Bench

EVALUATION = EvaluationSettings()
PAPER_III = (90.0, 15.0)
BEST_FIXED = {"none": (105.0, 45.0), "constant": (105.0, 45.0), "learned": (300.0, 30.0)}
"""K_p, K_i [1/s], [1/s^2]: the best of the grid behind each filter (results.md)."""
FIRST = 3.0
"""s that are looked at after the wait."""
PARTS = ("tracking", "interrupted", "waited", "fresh")
COLUMNS = {
    "part": "",
    "integral": "form of the law's integral",
    "filter": "",
    "controller": "K_p, K_i, or a policy",
    "case": "",
    "rmse": "N, mean over seeds; of the parts after a wait from its end on",
    "peak": "N, largest |e|, all seeds",
    "rate": "A/s, RMS of u', mean over seeds",
    "worst": "A/s, largest RMS of u' in the median step of 0.1 s, all seeds",
    "monitor": "what the trainer's monitor says first, and in how many of the seeds",
}


@dataclass
class Interrupted:
    """Another controller, with base gains for 0.1 s in every second."""

    choose: Chooser
    _step: int = field(default=0, init=False)

    def __call__(self, samples: FloatArray) -> FloatArray:
        """See `Chooser`."""
        self._step += 1
        changes = self.choose(samples)
        return np.zeros_like(changes) if self._step % 100 >= 90 else changes


@dataclass(frozen=True)
class Place:
    """Where a controller is tried."""

    integral: Integral
    filter: str
    wait: float

    def fleet(self) -> VectorBench:
        """A bench for each case."""
        count = len(EVALUATION.cases)
        filters = fleet_filter(self.filter, Bench.nominal(), count)
        return truth_fleet(count, box=BoxConfig(integral=self.integral), filters=filters)

    def play(self, part: str, choose: Chooser, seed: int) -> StateArray:
        """All samples that count, shape (cases, samples)."""
        if part in ("waited", "fresh"):
            return self._first(choose, seed, self.wait if part == "waited" else 0.0)
        chooser = Interrupted(choose) if part == "interrupted" else choose
        samples = vector_runs.record(self.fleet(), EVALUATION.cases, chooser, EVALUATION, seed)[1]
        return samples[:, round(EVALUATION.settle / SAMPLE_PERIOD) :]

    def _first(self, choose: Chooser, seed: int, wait: float) -> StateArray:
        fleet, cases = self.fleet(), EVALUATION.cases
        for index, case in enumerate(cases):
            fleet.begin(index, ReferenceSignal() if wait else case.signal, seed)
        for _ in range(round(wait / SAMPLE_PERIOD / SAMPLES_PER_STEP)):
            fleet.step(np.zeros((len(fleet), ACTIONS)))
        for index, case in enumerate(cases):
            command_now = Command(arm=True, reference=case.signal, filter_fresh=fleet.filters.fresh)
            fill_command(fleet.commands[index : index + 1], command_now)
        kept = [fleet.samples.copy()]
        for _ in range(round(FIRST / SAMPLE_PERIOD / SAMPLES_PER_STEP)):
            kept.append(fleet.step(choose(records(fleet.samples[:, -1], STATE_FIELDS))).copy())
        return np.concatenate(kept[1:], axis=1)


def verdict(samples: StateArray) -> tuple[float, str]:
    """Largest value of the monitor's chatter [A/s], and what it says first; samples of shape (n,)."""
    monitor, clock, worst, first = SafetyMonitor(), StepClock(), 0.0, ""
    values = records(samples, STATE_FIELDS)
    for k, sample in enumerate(samples):
        step = clock.add(int(sample["sequence"]), values[k], int(sample["flags"]))
        if step is not None:
            said = monitor.add(step)
            first = first or (said or "")
            worst = max(worst, monitor.chatter)
    return worst, first.split(",")[0]


def marks(runs: list[StateArray]) -> dict[str, Any]:
    """A row's figures from the same case with several seeds, each of shape (n,)."""
    errors = [run["reference_force"] - run["load_force"] for run in runs]
    rates = [np.diff(run["valve_current"]) / SAMPLE_PERIOD for run in runs]
    judged = [verdict(run) for run in runs]
    said = [sentence for _, sentence in judged if sentence]
    return {
        "rmse": float(np.mean([np.sqrt(np.mean(error**2)) for error in errors])),
        "peak": float(max(np.abs(error).max() for error in errors)),
        "rate": float(np.mean([np.sqrt(np.mean(rate**2)) for rate in rates])),
        "worst": max(worst for worst, _ in judged),
        "monitor": f"{said[0]} {len(said)}/{len(runs)}" if said else "",
    }


def controllers(files: list[Path], kind: str) -> dict[str, Callable[[], Chooser]]:
    """All that are tried behind a kind of filter, by name."""
    made: dict[str, Callable[[], Chooser]] = {}
    shipped = Path(str(resources.files("hydro_policy") / "data"))
    for file in files or sorted(shipped.glob("*/policy.safetensors"), reverse=True):
        policy, gains, _ = load_policy(file)
        made[file.parent.name] = lambda policy=policy, gains=gains: PolicyChooser(policy, gains)  # type: ignore[misc]
    for pair in (PAPER_III, BEST_FIXED[kind]):
        made["fixed ({:g}, {:g})".format(*pair)] = lambda pair=pair: vector_runs.fixed(np.array(pair))  # type: ignore[misc]
    return made


def rows(asked: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """All rows, as they come; a controller's four cases together."""
    for kind in asked.filter:
        for name, make in controllers(asked.policy, kind).items():
            for part in asked.part:
                for integral in asked.integral:
                    place = Place(integral, kind, asked.wait)
                    runs = [place.play(part, make(), seed) for seed in range(asked.seeds)]
                    for index, case in enumerate(EVALUATION.cases):
                        length = round((EVALUATION.length(case) - EVALUATION.settle) / SAMPLE_PERIOD)
                        ends = length if part in ("tracking", "interrupted") else runs[0].shape[1]
                        known = {"part": part, "integral": integral, "filter": kind, "controller": name}
                        yield {**known, "case": case.name, **marks([run[index, :ends] for run in runs])}


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.integral_form",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--integral", nargs="+", choices=get_args(Integral), default=("paper", "bumpless"))
    parser.add_argument("--filter", nargs="+", choices=FILTERS, default=("none", "learned"))
    parser.add_argument(
        "--policy", type=Path, nargs="+", default=[], metavar="FILE", help="instead of the shipped ones"
    )
    parser.add_argument(
        "--wait", type=float, default=60.0, metavar="S", help="armed at 0 N under base gains, default 60"
    )
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of the noise, default 3")
    add_json_argument(parser)
    asked = parser.parse_args()
    if asked.seeds < 1 or not 0.0 < asked.wait <= 3600.0:
        raise ValueError("--seeds is 1 or more, --wait above 0 and at most 3600 s")
    table = Table(COLUMNS, title="Both forms of the law's integral on the emulated bench")
    count = sum(len(controllers(asked.policy, kind)) for kind in asked.filter) * len(asked.part) * len(asked.integral)
    for values in progress(rows(asked), total=count * len(EVALUATION.cases), unit="row"):
        table.add(**values)
    table.show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
