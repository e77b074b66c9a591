# SPDX-License-Identifier: Apache-2.0
"""What the monitor's limit of chatter stands between: a good policy over changing references, and loops that cycle.

    python -m benchmarks.monitor_limits --runs 30 --json FILE

On the emulator's truth plant, without a clock. Good: the shipped wide policy behind the shipped filter, twelve sines of
300 N between 0.5 and 2 Hz one after another, changed at a random phase. Bad: gains without a filter, fixed or drawn at
every step, from K_p = 150 to 300, until the box trips. `window` is the RMS of u' over 0.1 s, which the monitor took
before decision 0072, `median` that of the median step of the same window, which it takes now.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.model_mismatch import SHIPPED
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.validation.trial import Corrector
from hydro_policy.evaluation.controllers import Controller, PolicyController
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.pretraining.configurations import WIDE
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.supervision.monitor import MonitorSettings, SafetyMonitor
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import BASE, GainRange
from hydro_policy.task.step_aggregator import Step
from hydro_sim.emulator.truth.config import profile
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench

LIMITS = MonitorSettings()
UNLIMITED = MonitorSettings(chatter=1e3, violations=1.0, peak_error=1e5)
FREQUENCIES = (0.5, 1.0, 1.5, 2.0)  # Hz
UNSTABLE = (150.0, 300.0)  # K_p [1/s]
COLUMNS = {
    "case": "",
    "runs": "number of runs",
    "window_worst": "A/s, largest RMS of u' over a window, of all runs",
    "window_stopped": "share of the runs in which it passes the limit",
    "window_lead": "s by which that is before the box trips, least and median of the runs",
    "median_worst": "A/s, largest RMS of u' in the median step of a window, of all runs",
    "median_stopped": "share of the runs in which it passes the limit",
    "median_lead": "s by which that is before the box trips, least and median of the runs",
}


@dataclass
class Gains:
    """K_p [1/s] and K_i [1/s^2] within the unstable range: fixed ones, or drawn at every step."""

    rng: np.random.Generator
    fixed: tuple[float, float] | None
    name: str = "gains"
    reach: GainRange = WIDE

    def reset(self) -> None:
        """Nothing to reset."""

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller.gains`."""
        kp, ki = self.fixed or (self.rng.uniform(*UNSTABLE), self.rng.uniform(5.0, 100.0))
        return float(kp - BASE[0]), float(ki - BASE[1])


class Watch(SafetyMonitor):
    """Notes both measures at each step, and stops nothing."""

    def __init__(self) -> None:
        super().__init__(UNLIMITED)
        self.window: list[float] = []
        self.median: list[float] = []

    def add(self, step: Step) -> str | None:
        """See `SafetyMonitor.add`."""
        said = super().add(step)
        if len(self._squares) == self._squares.maxlen:
            known = [square for square in self._squares if square is not None]
            self.window.append(float(np.sqrt(np.mean(known))))
            self.median.append(self.chatter)
        return said


@dataclass
class Group:
    """Runs of a row."""

    name: str
    watches: list[Watch] = field(default_factory=list)

    def row(self, tripping: bool) -> dict[str, Any]:
        """Return the row of the table; `tripping`: each run ended in a trip, which is what a lead is counted to."""
        row: dict[str, Any] = {"case": self.name, "runs": len(self.watches)}
        for measure in ("window", "median"):
            taken = [np.array(getattr(watch, measure)) for watch in self.watches]
            passed = [np.flatnonzero(values > LIMITS.chatter) for values in taken]
            leads = [
                SAMPLES_PER_STEP * SAMPLE_PERIOD * (len(v) - k[0]) for v, k in zip(taken, passed, strict=True) if len(k)
            ]
            row[f"{measure}_worst"] = round(max(float(values.max()) for values in taken), 3)
            row[f"{measure}_stopped"] = round(len(leads) / len(taken), 3)
            known = bool(leads) and tripping
            row[f"{measure}_lead"] = f"{min(leads):.2f}, {float(np.median(leads)):.2f}" if known else "-"
        return row


def run(controller: Controller, evaluation: EvaluationSettings, seed: int, corrector: Corrector | None) -> Watch:
    """Play the sines, until their end or until the box trips."""
    watch, bench = Watch(), Bench.nominal()
    guard = GuardSettings(delta_kp_max=WIDE.delta_kp_max, delta_ki_max=WIDE.delta_ki_max)
    plant = TruthPlant(profile("default"))
    graph = OfflineGraph(plant, bench, guard=guard, seed=seed, corrector=corrector)
    session = EvaluationSession(evaluation, [controller], graph, monitor=watch)
    while not (session.finished or any(score.stopped for score in session.scores)):
        graph.run(session, 0.01)
    return watch


def good(policy: Policy, seed: int) -> Watch:
    """Twelve sines behind the shipped filter, changed at a phase that the seed decides."""
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(FREQUENCIES) for _ in range(3)])
    sines = tuple(float(frequency) for frequency in order)
    evaluation = EvaluationSettings(frequencies=sines, settle=float(rng.uniform(0.5, 1.5)), measure=0.1)
    return run(PolicyController(policy, WIDE, "policy"), evaluation, seed, default_filter(Bench.nominal()))


def cases(runs: int) -> Iterator[tuple[Group, bool]]:
    """All rows, and whether their runs trip."""
    policy, _, _ = load_policy(SHIPPED)
    yield Group("policy behind the filter", [good(policy, seed) for seed in range(runs)]), False
    sine = EvaluationSettings(frequencies=(1.0,), settle=20.0, measure=0.1)
    for name in ("fixed gains", "drawn gains"):
        watches = []
        for seed in range(runs):
            rng = np.random.default_rng(seed)
            chosen = (UNSTABLE[0] + (UNSTABLE[1] - UNSTABLE[0]) * seed / max(runs - 1, 1), 30.0)
            watches.append(run(Gains(rng, chosen if name == "fixed gains" else None), sine, seed, None))
        yield Group(name + ", no filter", watches), True


@command()
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.monitor_limits", description=__doc__)
    parser.add_argument("--runs", type=int, default=30, help="of each row (default %(default)s)")
    add_json_argument(parser)
    asked = parser.parse_args()
    table = Table(COLUMNS, title=f"RMS of u' in 0.1 s; the monitor stops a policy beyond {LIMITS.chatter:g} A/s")
    for group, tripping in progress(cases(asked.runs), total=3, unit="row", every=10.0):
        table.add(**group.row(tripping))
    table.show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
