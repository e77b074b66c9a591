# SPDX-License-Identifier: Apache-2.0
"""Controllers side by side on any folder of truths: python -m benchmarks.controllers --truths FOLDER --json FILE.

Each truth file (truth.md) is a bench whose box believes the shipped bench.yaml. Everything runs on the emulator's plant
without clock, serial line or filter: the same samples to the bit, many times as fast. Rows of this version that are
there already are not run again: the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._model_based import (
    WEIGHTS,
    Fixed,
    Predictive,
    diagnosed_bench,
    equivalent,
    foreseen,
    known_bench,
    oracle,
)
from benchmarks._report import interquartile_mean, parser, results
from benchmarks._truths import drawn_truths, tracked, truth_fleet
from hydro_bridge.bags.writer import code_version
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.cli.console import Table, command
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_core.settings import SettingsError
from hydro_core.signals import FloatArray
from hydro_policy.compensation.estimator import Compensator, LoadCell
from hydro_policy.compensation.residual import Network, Residual
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_runs import VectorController, VectorPolicyController
from hydro_policy.evaluation.gain_search import GridSearch, GridSettings
from hydro_policy.runs.initial_agent import InitialAgent, load_initial_agent
from hydro_policy.sac.agent import actor_parameters
from hydro_policy.sac.policy import Policy
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_sim.emulator.truth.config import TruthConfig, load_truth
from hydro_sim.excitation import parse_schedule
from hydro_sim.model.bench import Bench
from hydro_sim.plotting import add_legend, figure

PAPER_GAINS = (90.0, 15.0)
ROBUST_GAINS = (40.0, 5.0)
"""No pair holds everywhere: where the valve has more gain than believed, full compensation of the velocity is unstable
at any gain. Of eighteen pairs these trip on the fewest of 40 truths of seed 7, and have the least error of those."""
SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_wide"))
SETTINGS = EvaluationSettings(multisine=True, steps=True)
SHORT = EvaluationSettings(settle=1.0, measure=2.0)
GRID = GridSettings()
SHOWN = {
    "paper_fixed": "paper's gains (90, 15)", "hindsight_fixed": "best fixed gains on each bench",
    "policy": "shipped policy", "compensated": "compensated law", "learned_residual": "with the learned residual",
}  # fmt: skip
"""Bars of the picture."""
CONTROLLERS = {
    "policy": "the shipped policy, its mean action",
    "compensated": "the compensated law, adaptive, from the estimator's start values",
    "learned_residual": "the same with the learned residual",
    "equivalent_nominal": "the compensated law, its coefficients held, by a simulation of the shipped bench.yaml",
    "equivalent_diagnosed": "the same of the file that `diagnose` makes of two recordings of the truth, 20 s each",
    "equivalent_known": "the same of a bench file with the truth's own parameters",
    "predictive_nominal": "model predictive control of a_3 on top of it by the same numbers",
    "predictive_diagnosed": "the same by the file that `diagnose` makes",
    "predictive_known": "the same by the truth's own parameters",
    "predictive_adaptive": "the compensated law, adaptive, under that control by the shipped bench.yaml",
    "oracle": "the compensated law, coefficients and corrections of a_3 learnt on the very truth and reference before",
    "compensated_specimen": "for the force in front of the load cell, whose amplifier is known: see true_rmse",
    "paper_fixed": "the paper's law at its gains (90, 15)",
    "robust_fixed": "at the gains that trip on the fewest truths of another draw",
    "hindsight_fixed": "at the best gains of a grid on that truth",
}


def load_cases(path: Path | None) -> tuple[Case, ...]:
    """References of a YAML list, a name each beside what a schedule says of a reference; else the six of `evaluate`.

    Raises SettingsError: the file does not hold such a list.
    """
    if path is None:
        return SETTINGS.cases
    entries = yaml.safe_load(path.read_text())
    if not isinstance(entries, list) or not all(isinstance(one, dict) and "waveform" in one for one in entries):
        raise SettingsError(f"{path} must hold a list of references")
    names = [str(entry.pop("name", "")) for entry in entries]
    segments = [{"seconds": 1.0, **entry, "waveform": str(entry["waveform"]).lower()} for entry in entries]
    signals = [segment.signal for segment in parse_schedule({"segments": segments}, str(path))]
    return tuple(map(Case, names, signals))


def measure(
    config: TruthConfig, cases: Sequence[Case], controller: VectorController, compensator: Compensator | None = None,
    residual: Residual | None = None, overlap: float = 0.0,
) -> list[dict[str, Any]]:  # fmt: skip
    """Run every case on this truth; one row of figures for each (see `tracked`). `overlap`: see `truth_fleet`."""
    return tracked(truth_fleet([config] * len(cases), overlap), cases, controller, SETTINGS, compensator, residual)


def run_one(config: TruthConfig, name: str, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """One controller on one truth."""
    count = len(cases)
    if name.endswith("_fixed"):
        gains = {"paper_fixed": PAPER_GAINS, "robust_fixed": ROBUST_GAINS}.get(name) or best_gains(config)
        return measure(config, cases, vector_runs.fixed_gains(np.array(gains)))
    if name == "policy":
        shipped = load_initial_agent(SHIPPED)
        policy = policy_of(actor_parameters(shipped.agent), shipped)
        return measure(config, cases, VectorPolicyController(policy, shipped.gains))
    law, residual = Compensator(count, law=BoxLaw()), None
    if name == "compensated_specimen":
        law = Compensator(count, law=BoxLaw(), cell=load_cell(config))
    elif name == "learned_residual":
        residual = Residual(count, Network.load())
    elif name != "compensated":
        law = knowing(config, name, cases)
    return measure(config, cases, vector_runs.fixed_gains(np.zeros(2), (0.0, 0.0)), law, residual)


def knowing(config: TruthConfig, name: str, cases: Sequence[Case]) -> Fixed:
    """The law of a peer that knows a bench file, or the truth itself."""
    beliefs = {"known": known_bench, "diagnosed": diagnosed_bench}
    bench = beliefs.get(name.split("_")[-1], lambda config: Bench.nominal())(config)
    if name == "oracle":
        return oracle(truth_fleet([config] * len(cases)), cases, SETTINGS)
    if name == "predictive_adaptive":
        return Predictive(cases, Compensator(len(cases)), bench, WEIGHTS[name])
    on = equivalent(bench, cases, SETTINGS)
    if name.startswith("equivalent"):
        return on
    return Predictive(cases, on, bench, WEIGHTS[name], foreseen(bench, cases, SETTINGS, on))


def load_cell(config: TruthConfig) -> LoadCell | None:
    """Amplifier of this truth's load cell; None: ideal, or of first order."""
    for lag in config.effects.sensor_lag:
        if lag.sensor == "load_force":
            return LoadCell(bandwidth=lag.bandwidth, damping=lag.damping) if lag.order == 2 else None
    bandwidth = config.bench.load_cell_bandwidth
    return None if bandwidth is None else LoadCell(bandwidth=bandwidth, damping=config.bench.load_cell_damping)


def best_gains(config: TruthConfig) -> tuple[float, float]:
    """The best pair of `evaluate --grid` on this truth, its runs shortened."""
    search = GridSearch(GRID)
    while (pair := search.next()) is not None:
        fleet, gains = truth_fleet([config] * len(SHORT.cases)), vector_runs.fixed_gains(np.array(pair))
        search.add_result(pair, vector_runs.rmse(fleet, SHORT.cases, gains, SHORT).tolist())
    return search.best


def policy_of(parameters: FloatArray, agent: InitialAgent) -> Policy:
    """The policy with these parameters, of an agent's shape."""
    policy = Policy(agent.sac)
    policy.load_flat(parameters)
    return policy


def table(rows: Sequence[dict[str, Any]], cases: Sequence[Case]) -> Table:
    """Interquartile mean (worst) RMSE [N] over the truths by reference, a row for each controller."""
    sizes = {case.name: next(row["reference_rms"] for row in rows if row["reference"] == case.name) for case in cases}
    units = {"controller": "", **{name: f"N, of {size:.0f} N RMS" for name, size in sizes.items()}}
    units |= {"mean": "N, % of each RMS", "u' RMS": "A/s", "trips": ""}
    made = Table(units, title="Force RMSE: interquartile mean, in % of the reference's RMS (worst)")
    for name in dict.fromkeys(row["controller"] for row in rows):
        own = [row for row in rows if row["controller"] == name]
        values = [np.array([row["rmse"] for row in own if row["reference"] == case.name]) for case in cases]
        means = [interquartile_mean(value) for value in values]
        shares = [100.0 * mean / sizes[case.name] for case, mean in zip(cases, means, strict=True)]
        cells = {
            case.name: f"{mean:.2f}, {share:.2f} % ({np.nanmax(value):.1f})"
            for case, mean, share, value in zip(cases, means, shares, values, strict=True)
        }
        rate = interquartile_mean(np.array([row["current_rate_rms"] for row in own]))
        told = {"mean": f"{np.mean(means):.2f}, {np.mean(shares):.2f} %", "u' RMS": f"{rate:.3f}"}
        told["trips"] = f"{sum(row['tripped'] for row in own)} of {len(own)}"
        made.add(controller=name, **cells, **told)
    return made


def picture(rows: Sequence[dict[str, Any]], cases: Sequence[Case], path: Path) -> None:
    """Draw the interquartile means [N] of the controllers of `SHOWN` that were run as bars, by reference."""
    sizes = {row["reference"]: row["reference_rms"] for row in rows}
    shown = {name: label for name, label in SHOWN.items() if any(row["controller"] == name for row in rows)}
    places, width = np.arange(len(cases)), 0.8 / len(shown)
    with figure(path, 1, size=(max(8.0, 1.2 * len(cases)), 3.2)) as (_, (axes,)):
        for number, (name, label) in enumerate(shown.items()):
            own = [row for row in rows if row["controller"] == name]
            found = [[row["rmse"] for row in own if row["reference"] == case.name] for case in cases]
            means = [interquartile_mean(np.array(values)) for values in found]
            bars = axes.bar(places + (number - 0.5 * len(shown) + 0.5) * width, means, width, label=label)
            axes.bar_label(bars, fmt="%.1f", fontsize=6)
        axes.set(yscale="log", ylim=(0.5, None), ylabel="force RMSE [N]")
        axes.set_xticks(places, [f"{case.name}\n{sizes[case.name]:.0f} N RMS" for case in cases], fontsize=6)
        add_legend(axes)


def run(asked: argparse.Namespace, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Rows of all controllers asked for on the truths of the folder, drawn first where that is asked for.

    Rows of this version that are kept beside --json are not run again.
    """
    if asked.draw:
        asked.truths.mkdir(parents=True, exist_ok=True)
        for name, contents in drawn_truths(asked.draw, asked.seed).items():
            (asked.truths / f"{name}.yaml").write_text(yaml.safe_dump(contents))
    truths = sorted(asked.truths.glob("*.yaml"))
    if not truths:
        raise SettingsError(f"{asked.truths} holds no truth files, *.yaml; --draw 40 writes some")
    kept = Path(asked.json or asked.truths / "controllers.json").with_suffix(".rows")
    keys = {path: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in truths}
    wanted = {f"{keys[path]} {name}": (load_truth(path), name, cases) for path in truths for name in asked.controllers}
    found = results(run_one, wanted, asked, (cases, SETTINGS, code_version()), kept, label="runs", unit="run")
    return [
        {"truth": path.stem, "controller": name, **row}
        for path in truths for name in asked.controllers for row in found[f"{keys[path]} {name}"]
    ]  # fmt: skip


@command(ValueError, OSError)
def main() -> None:
    """Measure, print, write."""
    options = parser("controllers", __doc__, parallel=True)
    options.epilog = "controllers:\n" + "\n".join(f"  {name:20}  {what}" for name, what in CONTROLLERS.items())
    options.add_argument("--truths", type=Path, required=True, metavar="FOLDER", help="truth files, *.yaml")
    options.add_argument("--draw", type=int, default=0, metavar="COUNT", help="write so many drawn truths there first")
    options.add_argument("--seed", type=int, default=1, help="of the draw; default: %(default)s")
    options.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), choices=CONTROLLERS, metavar="NAME")
    options.add_argument("--references", type=Path, metavar="FILE", help="YAML list; default: the six of evaluate")
    options.add_argument("--fast", action="store_true", help="sines of 5 Hz, 100 N, and 10 Hz, 50 N, too")
    options.add_argument(
        "--recorded", type=Path, nargs="+", default=[], metavar="FILE", help="recorded references, too: as `evaluate`"
    )
    options.add_argument("--picture", type=Path, metavar="FILE", help="bars of the controllers of README")
    asked = options.parse_args()
    extra = replace(SETTINGS, fast=asked.fast, recorded=tuple(map(str, asked.recorded))).cases[len(SETTINGS.cases) :]
    cases = load_cases(asked.references) + extra
    rows = run(asked, cases)
    table(rows, cases).show()
    if asked.picture:
        picture(rows, cases, asked.picture)
    if asked.json:
        write_atomic(asked.json, encode_json({"rows": rows}))


if __name__ == "__main__":
    main()
