# SPDX-License-Identifier: Apache-2.0
"""Does adaptivity pay? The best fixed gains by a grid, a gain-scheduled law by hand, and policies, on 300 N sines.

Plant: the learned model, or with `--emulator` the emulated bench's truth; with and without the filter between gains and
valve. `--changed` puts the same controllers on benches with another spring or supply pressure; gains and policies stay
those of the nominal bench. RMSE in N; `tripped`: the load force passed the box's limit.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np

from benchmarks._truth_fleet import TruthPlant
from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_bridge.signals import FloatArray
from hydro_policy.envs import vector_runs
from hydro_policy.envs.filter_kinds import FILTERS
from hydro_policy.envs.randomisation import Randomisation, draw_bench
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.envs.vector_filter import fleet_filter
from hydro_policy.envs.vector_runs import Chooser, PolicyChooser, fixed
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.cases import EvaluationSettings
from hydro_policy.task.mdp import LOAD_FORCE, LOAD_FORCE_RATE, REFERENCE, REFERENCE_RATE
from hydro_sim.emulator.truth.config import profile
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant

SETTINGS = EvaluationSettings()
KP = (60.0, 75.0, 90.0, 100.0, 105.0, 110.0, 115.0, 120.0, 150.0, 200.0, 300.0)
KI = (5.0, 15.0, 50.0, 100.0)
PAPER = (90.0, 15.0)
BENCHES = (
    (2e4, 16e6), (1e4, 16e6), (1.4e4, 16e6), (2.8e4, 16e6), (4e4, 16e6), (5e4, 16e6), (2e4, 13e6), (2e4, 10e6),
)  # fmt: skip
"""Spring [N/m] and supply pressure [Pa]; the first is the nominal bench."""


@dataclass(frozen=True)
class Place:
    """Where controllers are compared."""

    emulator: bool
    filter: str
    spring: float = 2e4
    supply: float = 16e6

    def fleet(self, count: int) -> VectorBench:
        """So many of these benches; the boxes and the filter believe in the nominal one."""
        believed = Bench.nominal()
        plants = [self._plant() for _ in range(count)]
        return VectorBench([believed] * count, plants, filters=fleet_filter(self.filter, believed, count))

    def _plant(self) -> Plant:
        if self.emulator:
            truth = profile("default")
            bench = replace(truth.bench, spring_stiffness=self.spring, supply_pressure=self.supply)
            return TruthPlant(replace(truth, bench=bench))
        only = Randomisation(
            spring_min=self.spring, spring_max=self.spring, supply_min=self.supply, supply_max=self.supply, spread=0.0,
            noise_min=1.0, noise_max=1.0,
        )  # fmt: skip
        return draw_bench(only, Learned.load(None), 0).plant


def scheduled(samples: FloatArray) -> FloatArray:
    """K_p = (152 e + 2.5 e') / e within [15, 235], K_i = 75: a derivative's action by the proportional gain alone."""
    error = samples[:, REFERENCE] - samples[:, LOAD_FORCE]
    rate = samples[:, REFERENCE_RATE] - samples[:, LOAD_FORCE_RATE]
    divisor = np.where(np.abs(error) < 0.3, np.copysign(0.3, error), error)
    kp = np.clip((152.0 * error + 2.5 * rate) / divisor, 15.0, 235.0)
    return np.stack((kp - 15.0, np.full(len(samples), 70.0)), axis=1)


def rmse(place: Place, choose: Callable[[], Chooser], seeds: Sequence[int]) -> FloatArray:
    """Shape (seeds, cases)."""
    cases = SETTINGS.cases
    return np.array([vector_runs.rmse(place.fleet(len(cases)), cases, choose(), SETTINGS, seed) for seed in seeds])


def grid(place: Place) -> tuple[list[tuple[float, float]], FloatArray]:
    """All pairs and their RMSE, shape (pairs, cases)."""
    pairs, cases = list(itertools.product(KP, KI)), SETTINGS.cases
    gains = np.repeat(np.array(pairs), len(cases), axis=0)
    found = vector_runs.rmse(place.fleet(len(gains)), list(cases) * len(pairs), fixed(gains), SETTINGS)
    return pairs, found.reshape(len(pairs), len(cases))


def best(pairs: list[tuple[float, float]], found: FloatArray) -> tuple[tuple[float, float], FloatArray, list[str]]:
    """The best pair overall (by the mean of RMSE over the best at each case); the best at each case, and which."""
    at_best = np.nanmin(found, axis=0)
    overall = int(np.nanargmin(np.where(np.isnan(found), np.inf, found / at_best).mean(axis=1)))
    which = ["({:g}, {:g})".format(*pairs[int(row)]) for row in np.nanargmin(found, axis=0)]
    return pairs[overall], at_best, which


def main() -> int:
    """Measure and show."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adaptivity", description=__doc__)
    parser.add_argument("--filter", choices=FILTERS, nargs="+", default=["none", "learned"])
    parser.add_argument("--policy", type=Path, nargs="*", default=[], metavar="FILE", help="besides the shipped ones")
    parser.add_argument("--emulator", action="store_true", help="the emulated bench instead of the learned model")
    parser.add_argument("--changed", action="store_true", help="other springs and supply pressures, too")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of the noise (3)")
    add_json_argument(parser)
    options = parser.parse_args()
    names = {case.name: "RMSE [N], mean over seeds" for case in SETTINGS.cases}
    columns = {"filter": "", "spring": "N/m", "supply": "MPa", "controller": "K_p, K_i, or a policy"}
    table = Table({**columns, **names, "spread": "largest standard deviation over seeds [N]"}, title=_title(options))
    benches = BENCHES if options.changed else BENCHES[:1]
    for kind in progress(options.filter, label="filters", unit="filter"):
        tuned = Place(options.emulator, kind)
        pairs, found = grid(tuned)
        overall, at_best, which = best(pairs, found)
        _add(table, tuned, "best fixed at each: " + " ".join(which), at_best[np.newaxis])
        for spring, supply in benches:
            place = replace(tuned, spring=spring, supply=supply)
            for name, choose in controllers(overall, options.policy).items():
                _add(table, place, name, rmse(place, choose, range(options.seeds)))
    table.show(options.json)
    return 0


def controllers(overall: tuple[float, float], files: Sequence[Path]) -> dict[str, Callable[[], Chooser]]:
    """All that are compared, by name."""
    made: dict[str, Callable[[], Chooser]] = {
        "fixed ({:g}, {:g})".format(*PAPER): lambda: fixed(np.array(PAPER)),
        "best fixed overall ({:g}, {:g})".format(*overall): lambda: fixed(np.array(overall)),
        "scheduled by hand": lambda: scheduled,
    }
    shipped = Path(str(resources.files("hydro_policy") / "data"))
    for file in [*sorted(shipped.glob("*/policy.safetensors")), *files]:
        policy, gains, _ = load_policy(file)
        made[f"policy {file.parent.name}"] = lambda policy=policy, gains=gains: PolicyChooser(policy, gains)  # type: ignore[misc]
    return made


def _add(table: Table, place: Place, name: str, found: FloatArray) -> None:
    values = {case.name: float(value) for case, value in zip(SETTINGS.cases, found.mean(axis=0), strict=True)}
    where = {"filter": place.filter, "spring": place.spring, "supply": place.supply * 1e-6}
    table.add(**where, controller=name, **values, spread=float(found.std(axis=0).max()))


def _title(options: argparse.Namespace) -> str:
    return "300 N sines on " + ("the emulated bench" if options.emulator else "the learned model")


if __name__ == "__main__":
    sys.exit(main())
