# SPDX-License-Identifier: Apache-2.0
"""Controllers side by side on any folder of truths: python -m benchmarks.controllers --truths FOLDER --json FILE.

Each truth file (truth.md) is a bench whose box believes the shipped bench.yaml. Everything runs on the emulator's plant
without clock, serial line or filter: the same samples to the bit, many times as fast. Rows of this version that are
there already are not run again: the same command goes on after an interruption.

policy           the shipped policy, its mean action
compensated      the compensated law, adaptive, from neutral coefficients
learned_residual  the same with the learned residual
amplitude_phase  the same with amplitude and phase control in its place
filtered_x       the same with adaptive inverse control by the filtered-x LMS algorithm in its place
equivalent_nominal  the compensated law, its coefficients held, by a simulation of the shipped bench.yaml beforehand
equivalent_diagnosed  the same of the bench file that `diagnose` makes of two recordings of the truth, 20 s each
equivalent_known  the same of a bench file with the truth's own parameters
predictive_nominal, _diagnosed, _known  the same under model predictive control of a_3 by the same numbers
predictive_adaptive  the compensated law, adaptive, under that control by the shipped bench.yaml
oracle           the compensated law, coefficients and corrections of a_3 learnt on the very truth and reference before
compensated_specimen  the same for the force in front of the load cell, whose amplifier is known: see true_rmse
paper_fixed      the paper's law at its gains (90, 15)
robust_fixed     the paper's law at the gains that trip on the fewest truths of another draw (--robust finds them)
hindsight_fixed  the paper's law at the best gains of a grid on that truth
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml

from benchmarks._adaptive_feedforward import RATES, Feedforward
from benchmarks._drawn_truths import drawn_truths
from benchmarks._model_based import Fixed, diagnosed_bench, equivalent, foreseen, known_bench, oracle
from benchmarks._model_predictive import WEIGHTS, Predictive
from benchmarks._report import parser
from benchmarks._truth_fleet import truth_fleet
from hydro_bridge.bags.writer import code_version
from hydro_bridge.cli import jobs
from hydro_bridge.cli.console import Table, command
from hydro_bridge.serial.protocol import BoxLaw
from hydro_bridge.settings import SettingsError, from_mapping, quantity
from hydro_bridge.signals import SAMPLE_PERIOD, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import Compensator, LoadCell
from hydro_policy.compensation.residual import Network, Residual
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_runs import Chooser, PolicyChooser
from hydro_policy.evaluation.gain_search import GridSearch, GridSettings
from hydro_policy.runs.initial_agent import InitialAgent, load_initial_agent
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_sim.box import reference
from hydro_sim.emulator.truth.config import TruthConfig, load_truth, truth_from_mapping
from hydro_sim.model.bench import Bench
from hydro_sim.plotting import figure, legend

PAPER_GAINS = (90.0, 15.0)
ROBUST_GAINS = (40.0, 5.0)
"""Of `--robust`. No pair holds everywhere: where the valve has more gain than believed, full compensation of the
velocity is unstable at any gain, so these trip on the fewest of 40 truths of seed 7, then have the least error."""
SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_wide"))
SETTINGS = EvaluationSettings(multisine=True, steps=True)
SHORT = EvaluationSettings(settle=1.0, measure=2.0)
GRID = GridSettings()
SHOWN = {
    "paper_fixed": "paper's gains (90, 15)", "hindsight_fixed": "best fixed gains on each bench",
    "policy": "shipped policy", "compensated": "compensated law", "learned_residual": "with the learned residual",
}  # fmt: skip
"""Bars of the picture."""
CONTROLLERS = (
    "policy",
    "compensated",
    "learned_residual",
    "amplitude_phase",
    "filtered_x",
    "equivalent_nominal",
    "equivalent_diagnosed",
    "equivalent_known",
    "predictive_nominal",
    "predictive_diagnosed",
    "predictive_known",
    "predictive_adaptive",
    "oracle",
    "compensated_specimen",
    "paper_fixed",
    "robust_fixed",
    "hindsight_fixed",
)


@dataclass(frozen=True, kw_only=True)
class Reference:
    """An entry of a file of references."""

    name: str
    """Name in the rows."""
    waveform: str
    """SINE, MULTISINE, SMOOTH_STEP or HOLD."""
    amplitude: Annotated[float, quantity("N", 0.0, 1e5)] = 0.0
    """Peak."""
    offset: Annotated[float, quantity("N", -1e5, 1e5)] = 0.0
    """Mean."""
    frequency: Annotated[float, quantity("Hz", 0.01, 100.0)] = 1.0
    """Of a multisine: its slowest sine."""
    phase: Annotated[float, quantity("rad", -10.0, 10.0)] = 0.0
    """At the beginning."""


def load_cases(path: Path | None) -> tuple[Case, ...]:
    """References of a YAML list of `Reference`; without a file the six of `evaluate`.

    Raises SettingsError: the file does not hold such a list.
    """
    if path is None:
        return SETTINGS.cases
    entries = yaml.safe_load(path.read_text())
    if not isinstance(entries, list) or not entries:
        raise SettingsError(f"{path} must hold a list of references")
    cases = []
    for number, entry in enumerate(entries):
        one = from_mapping(Reference, entry, f"{path}[{number}]")
        if one.waveform not in Waveform.__members__:
            raise SettingsError(f"{path}[{number}].waveform must be one of {', '.join(Waveform.__members__)}")
        numbers = {key: value for key, value in asdict(one).items() if key not in ("name", "waveform")}
        cases.append(Case(one.name, ReferenceSignal(waveform=Waveform[one.waveform], **numbers)))
    return tuple(cases)


def measure(
    config: TruthConfig, cases: Sequence[Case], choose: Chooser, compensator: Compensator | None = None,
    residual: Residual | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Run every case on this truth; one row of figures for each (see `outcome`)."""
    fleet = truth_fleet(len(cases), config)
    sums, tripped = np.zeros((4, len(cases))), np.zeros(len(cases), bool)
    before = fleet.samples["valve_current"][:, -1]
    for step in vector_runs.run(fleet, cases, choose, SETTINGS, 0, compensator, residual):
        wanted, current = step.samples["reference_force"], step.samples["valve_current"]
        rate = np.diff(current, axis=1, prepend=before[:, np.newaxis]) / SAMPLE_PERIOD
        before = current[:, -1].copy()
        for row, signal in enumerate((wanted - step.samples["load_force"], wanted - fleet.rows.felt, rate)):
            sums[row] += np.sum(np.where(step.counted, signal, 0.0) ** 2, axis=1)
        sums[3] += step.counted.sum(axis=1)
        tripped |= np.any(step.samples["flags"] & Flag.TRIPPED, axis=1)
    figures = np.sqrt(sums[:3] / sums[3])
    return [outcome(case, figures[:, k], bool(tripped[k])) for k, case in enumerate(cases)]


def outcome(case: Case, figures: FloatArray, tripped: bool) -> dict[str, Any]:
    """RMSE of the measured force and of the load's own [N], RMS of u' [A/s]; where it tripped, the reference's RMS."""
    rmse, felt, rate = map(float, figures)
    if tripped:
        times = np.arange(SETTINGS.settle, SETTINGS.length(case), SAMPLE_PERIOD)
        rmse = felt = float(np.sqrt(np.mean(reference.sample(case.signal, times)[0] ** 2)))
    return {"reference": case.name, "rmse": rmse, "true_rmse": felt, "current_rate_rms": rate, "tripped": tripped}


def run_one(config: TruthConfig, name: str, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """One controller on one truth."""
    if name.startswith("compensated"):
        return compensated(config, cases, cell=load_cell(config) if name == "compensated_specimen" else None)
    if name == "learned_residual":
        return compensated(config, cases, residual=Residual(len(cases), Network.load()))
    if name.startswith(("equivalent", "predictive", "oracle")):
        return knowing(config, name, cases)
    if name in RATES:
        return compensated(config, cases, residual=Feedforward(len(cases), name))
    if name == "policy":
        shipped = load_initial_agent(SHIPPED)
        return measure(config, cases, mean_action(actor_parameters(shipped.agent), shipped))
    gains = {"paper_fixed": PAPER_GAINS, "robust_fixed": ROBUST_GAINS}.get(name) or best_gains(config)
    return measure(config, cases, held(gains))


def knowing(config: TruthConfig, name: str, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """A peer that knows a bench file, or the truth itself."""
    beliefs = {"known": known_bench, "diagnosed": diagnosed_bench}
    bench = beliefs.get(name.split("_")[-1], lambda config: Bench.nominal())(config)
    if name == "oracle":
        on: Fixed = oracle(truth_fleet(len(cases), config), cases, SETTINGS)
    elif name == "predictive_adaptive":
        on = Predictive(cases, Compensator(len(cases)), bench, WEIGHTS[name])
    else:
        on = equivalent(bench, cases, SETTINGS)
    if name.startswith("predictive") and name != "predictive_adaptive":
        on = Predictive(cases, on, bench, WEIGHTS[name], foreseen(bench, cases, SETTINGS, on))
    return measure(config, cases, vector_runs.fixed(np.zeros(2), (0.0, 0.0)), on)


def compensated(
    config: TruthConfig, cases: Sequence[Case], cell: LoadCell | None = None, residual: Residual | None = None
) -> list[dict[str, Any]]:
    """The compensated law, adaptive, from neutral coefficients; rows as of `measure`."""
    estimator = Compensator(len(cases), law=BoxLaw(), cell=cell)
    return measure(config, cases, vector_runs.fixed(np.zeros(2), (0.0, 0.0)), estimator, residual)


def load_cell(config: TruthConfig) -> LoadCell | None:
    """Amplifier of this truth's load cell; None: ideal, or of first order."""
    for lag in config.effects.sensor_lag:
        if lag.sensor == "load_force":
            return LoadCell(bandwidth=lag.bandwidth, damping=lag.damping) if lag.order == 2 else None
    bandwidth = config.bench.load_cell_bandwidth
    return None if bandwidth is None else LoadCell(bandwidth=bandwidth, damping=config.bench.load_cell_damping)


def held(gains: tuple[float, float]) -> Chooser:
    """Fixed gains (K_p, K_i) of the paper's law."""
    return vector_runs.fixed(np.array(gains))


def best_gains(config: TruthConfig) -> tuple[float, float]:
    """The best pair of `evaluate --grid` on this truth, its runs shortened."""
    search = GridSearch(GRID)
    while (pair := search.next()) is not None:
        fleet = truth_fleet(len(SHORT.cases), config)
        search.tell(pair, vector_runs.rmse(fleet, SHORT.cases, held(pair), SHORT).tolist())
    return search.best


def policy_of(parameters: FloatArray, agent: InitialAgent) -> Policy:
    """The policy with these parameters, of an agent's shape."""
    policy = Policy(agent.sac)
    policy.load_flat(parameters)
    return policy


def mean_action(parameters: FloatArray, agent: InitialAgent) -> Chooser:
    """Its mean action within the agent's authority, from the beginning of a run."""
    return PolicyChooser(policy_of(parameters, agent), agent.gains)


def robust_gains(truths: Iterable[TruthConfig], **where: Any) -> tuple[float, float]:
    """Pair that trips on the fewest of these truths, then with the least interquartile mean; prints all.

    A trip counts as the reference's RMS.
    """
    configs = list(truths)
    pairs = {f"{kp:g}, {ki:g}": (kp, ki) for kp in (15.0, 22.0, 30.0, 40.0, 50.0, 60.0) for ki in (5.0, 10.0, 15.0)}
    scores = {}
    for name, (trips, mean) in jobs.run(pair_score, {name: (pairs[name], configs) for name in pairs}, **where):
        scores[name] = trips, mean
        print(f"{name}: {trips} truths with a trip, {mean:.1f} N", flush=True)
    return pairs[min(pairs, key=scores.__getitem__)]


def pair_score(pair: tuple[float, float], configs: Sequence[TruthConfig]) -> tuple[int, float]:
    """Truths on which it trips, and its interquartile mean [N]."""
    cases = SHORT.cases
    rmse = np.array([vector_runs.rmse(truth_fleet(len(cases), each), cases, held(pair), SHORT) for each in configs])
    mean = interquartile_mean(np.nan_to_num(rmse, nan=SHORT.amplitude / math.sqrt(2.0)).mean(axis=1))
    return int(np.isnan(rmse).any(axis=1).sum()), mean


def interquartile_mean(values: FloatArray) -> float:
    """Mean of the middle half."""
    ordered = np.sort(values)
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def table(rows: Sequence[dict[str, Any]], cases: Sequence[Case]) -> Table:
    """Interquartile mean (worst) RMSE [N] over the truths by reference, a row for each controller."""
    units = {"controller": "", **dict.fromkeys((case.name for case in cases), "N"), "mean": "N", "u' RMS": "A/s"}
    made = Table({**units, "trips": ""}, title="Force RMSE: interquartile mean (worst)")
    for name in dict.fromkeys(row["controller"] for row in rows):
        own = [row for row in rows if row["controller"] == name]
        values = [np.array([row["rmse"] for row in own if row["reference"] == case.name]) for case in cases]
        means = [interquartile_mean(value) for value in values]
        cells = {c.name: f"{m:.2f} ({np.nanmax(v):.1f})" for c, m, v in zip(cases, means, values, strict=True)}
        rate = interquartile_mean(np.array([row["current_rate_rms"] for row in own]))
        told = {"mean": f"{np.mean(means):.2f}", "u' RMS": f"{rate:.3f}"}
        told["trips"] = f"{sum(row['tripped'] for row in own)} of {len(own)}"
        made.add(controller=name, **cells, **told)
    return made


def picture(rows: Sequence[dict[str, Any]], cases: Sequence[Case], path: Path) -> None:
    """Draw the interquartile means [N] of the controllers of `SHOWN` as bars, by reference."""
    places, width = np.arange(len(cases)), 0.8 / len(SHOWN)
    with figure(path, 1, size=(8.0, 3.2)) as (_, (axes,)):
        for number, (name, label) in enumerate(SHOWN.items()):
            own = [row for row in rows if row["controller"] == name]
            found = [[row["rmse"] for row in own if row["reference"] == case.name] for case in cases]
            means = [interquartile_mean(np.array(values)) for values in found]
            bars = axes.bar(places + (number - 1.5) * width, means, width, label=label)
            axes.bar_label(bars, fmt="%.1f", fontsize=6)
        axes.set(
            yscale="log",
            ylim=(1.0, None),
            ylabel="force RMSE [N]",
            xticks=places,
            xticklabels=[case.name for case in cases],
        )
        legend(axes)


def complete(
    truths: Sequence[Path], names: Sequence[str], cases: Sequence[Case], kept: Path, **where: Any
) -> list[dict[str, Any]]:
    """All rows, those of the jobs in `kept` first; the missing ones are run and added there."""
    digest = hashlib.sha256(repr((cases, SETTINGS, code_version())).encode()).hexdigest()[:12]
    keys = {path: hashlib.sha256(path.read_bytes()).hexdigest()[:12] + digest for path in truths}
    wanted = {f"{keys[path]} {name}": (load_truth(path), name, cases) for path in truths for name in names}
    found = jobs.complete(run_one, wanted, kept=kept, **where, label="runs", unit="run")
    return [
        {"truth": path.stem, "controller": name, **row}
        for path in truths for name in names for row in found[f"{keys[path]} {name}"]
    ]  # fmt: skip


def run(asked: argparse.Namespace, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Rows of all controllers asked for on the truths of the folder, drawn first where that is asked for."""
    if asked.draw:
        asked.truths.mkdir(parents=True, exist_ok=True)
        for name, contents in drawn_truths(asked.draw, asked.seed).items():
            (asked.truths / f"{name}.yaml").write_text(yaml.safe_dump(contents))
    truths = sorted(asked.truths.glob("*.yaml"))
    if not truths:
        raise SettingsError(f"{asked.truths} holds no truth files, *.yaml; --draw 40 writes some")
    kept = Path(asked.json or asked.truths / "controllers.json").with_suffix(".rows")
    return complete(truths, asked.controllers, cases, kept, **jobs.where(asked))


@command(ValueError, OSError)
def main() -> None:
    """Measure, print, write."""
    options = parser("controllers", __doc__)
    source = options.add_mutually_exclusive_group(required=True)
    source.add_argument("--truths", type=Path, metavar="FOLDER", help="truth files, *.yaml")
    source.add_argument("--rows", type=Path, nargs="+", metavar="FILE", help="run nothing: show what --json wrote")
    source.add_argument("--robust", action="store_true", help="find robust_fixed's gains on 40 drawn truths, and end")
    options.add_argument("--draw", type=int, default=0, metavar="COUNT", help="write so many drawn truths there first")
    options.add_argument("--seed", type=int, default=1, help="of the draw; default: %(default)s")
    options.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), choices=CONTROLLERS, metavar="NAME")
    options.add_argument("--references", type=Path, metavar="FILE", help="YAML list; default: the six of evaluate")
    options.add_argument("--picture", type=Path, metavar="FILE", help="bars of the controllers of README")
    jobs.add_arguments(options)
    asked = options.parse_args()
    if asked.robust:
        drawn = map(truth_from_mapping, drawn_truths(40, seed=7).values())
        print(f"best: {robust_gains(drawn, **jobs.where(asked))}")
        return
    cases = load_cases(asked.references)
    if asked.rows:
        rows = [row for file in asked.rows for row in json.loads(file.read_text())["rows"]]
    else:
        rows = run(asked, cases)
    table(rows, cases).show()
    if asked.picture:
        picture(rows, cases, asked.picture)
    if asked.json:
        asked.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
