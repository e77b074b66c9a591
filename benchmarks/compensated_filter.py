# SPDX-License-Identifier: Apache-2.0
"""The contraction filter beside the compensated law: on the default truth and on drawn ones.

Each truth's bench file has the truth's own parameters in the model's own forms, in place of what a diagnosis finds; its
metric is made by `learn_metric --epochs 0`. The box believes the shipped bench.yaml.

law      sines of 300 N under the law's own gains, sample by sample through guard and estimator: without a filter, with
         the filter of that bench file, and with the shipped one, which answers BYPASSED; `mismatch` of the latter is
         what its watch says of the same samples
gains    K_p 15 to 300, K_i 5 to 30 drawn anew 100 times a second at several C_1, without and with the filter of the
         bench file, many runs at once (no guard, no watch)
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._drawn_truths import drawn_truths
from benchmarks.bench_file_filter import loaded, metric
from benchmarks.controllers import SETTINGS, interquartile_mean, measure
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, CorrectionStatus, Flag, FloatArray, Law
from hydro_filter.controller.loop_decision import SAME
from hydro_filter.controller.loop_filter import LoopFilter, default_filter, loop_parts
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.model.sample import Sample
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.envs.vector_filter import FleetFilter, loop_fleet_filter
from hydro_policy.envs.vector_runs import Chooser
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.task.cases import Case
from hydro_sim.box.box import BoxConfig, law_state
from hydro_sim.emulator.truth.config import TruthConfig, profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench

CASES = SETTINGS.cases[:4]
BEGIN, SECONDS = 2000, 6.0
COMPENSATIONS = (1.0, 0.8, 0.5, 0.3)
DRAWN = (15.0, 300.0), (5.0, 30.0)
"""K_p [1/s] and K_i [1/s^2] of the drawn gains."""
FORMS: dict[str, tuple[str, ...]] = {
    "spring_stiffness": ("ratio",), "supply_pressure": ("ratio",), "valve_gain": ("ratio",),
    "valve_gain_asymmetry": ("ratio",), "leakage_internal": ("coefficient",), "friction_coulomb": ("force",),
    "friction_stribeck": ("breakaway_force", "velocity"), "friction_presliding": ("stiffness",),
    "valve_lag": ("bandwidth", "damping"), "moving_mass": ("mass",), "valve_deadband": ("half_width",),
    "entrained_air": ("volume_fraction",),
}  # fmt: skip
"""Effects of the truths, with the parameters that the model's own forms have."""


def bench_file(config: TruthConfig, path: Path) -> Path:
    """Write the bench file with a truth's own parameters."""
    found = {name: getattr(config.effects, name) for name in FORMS}
    effects: list[dict[str, Any]] = [
        {"id": name, "parameters": {each: getattr(effect, each) for each in FORMS[name]}}
        for name, effect in found.items() if effect is not None
    ]  # fmt: skip
    effects += [
        {"id": "sensor_lag", "sensor": lag.sensor, "parameters": {"bandwidth": lag.bandwidth, "damping": lag.damping}}
        for lag in config.effects.sensor_lag
    ]
    path.write_text(yaml.safe_dump(Bench.nominal().to_mapping() | {"effects": effects}), encoding="utf-8")
    return path


def made_for(name: str, config: TruthConfig, folder: Path, law: str) -> tuple[LoopFilter, LearnedMetric, Path]:
    """The filter on a truth's own bench file; files that are there already are taken (raises ValueError: has none)."""
    model, made = folder / f"{name}.yaml", folder / f"{name}.safetensors"
    if not made.exists():
        metric(bench_file(config, model), folder, law)
    return loaded(made, model), LearnedMetric.load(made), model


def under_the_law(config: TruthConfig, case: Case, corrector: LoopFilter | None) -> Iterator[tuple[np.void, int]]:
    """Samples of a run at the law's own gains, each with its status, until the box trips."""
    graph = OfflineGraph(TruthPlant(config), Bench.nominal(), corrector=corrector)
    live = LiveCompensation(graph.box.config.compensated)
    if corrector is not None:
        corrector.reset()
    graph.reference(case.signal)
    for k in range(round(SECONDS / SAMPLE_PERIOD)):
        if k % SAMPLES_PER_STEP == 0:
            graph.command_law(live.command, k)
            graph.gains(0.0, 0.0, k)
        graph.arm(k > 0)
        sample, law = graph.sample().copy(), law_state(graph.box.state[0])
        sequence, mismatched = int(sample["sequence"]), graph.answer.status is CorrectionStatus.MISMATCH
        if law.law is Law.COMPENSATED:
            live.on_law_state(sequence, law.law, law.compensated_reference)
        live.on_sample(sequence, float(sample["load_force"]), int(sample["flags"]), holds=mismatched)
        yield sample, int(graph.answer.status)
        if int(sample["flags"]) & Flag.TRIPPED:
            return


def law_rows(name: str, config: TruthConfig, own: LoopFilter | None, shipped: LoopFilter) -> list[dict[str, Any]]:
    """Three rows of each reference: without a filter, with its own, and with the shipped one."""
    rows = []
    for case in CASES:
        for told, corrector in (("none", None), *([("own", own)] if own is not None else [])):
            done = list(under_the_law(config, case, corrector))
            rows.append({"truth": name, "filter": told, "reference": case.name, **figures(done)})
            if told == "none":
                shipped.reset()
                watched = [(sample, int(shipped.correct(Sample.of(sample)).status)) for sample, _ in done]
                shares = {**figures(watched), "corrected": 0.0}
                rows.append({"truth": name, "filter": "shipped", "reference": case.name, **shares})
    return rows


def figures(done: Sequence[tuple[np.void, int]]) -> dict[str, Any]:
    """Error after 2 s [N], RMS of u' [A/s], and shares of samples [%]."""
    states = np.array([sample for sample, _ in done])
    settled, statuses = states[BEGIN:], np.array([status for _, status in done[BEGIN:]])
    error = settled["reference_force"] - settled["load_force"]
    tripped = bool(int(states["flags"][-1]) & Flag.TRIPPED)
    share = {
        "mismatch": statuses == CorrectionStatus.MISMATCH,
        "corrected": np.isin(statuses, [int(CorrectionStatus.MODIFIED), int(CorrectionStatus.RELAXED)]),
    }
    means = {key: 100.0 * float(np.mean(which)) if len(which) else 0.0 for key, which in share.items()}
    rate = np.diff(settled["valve_current"]) / SAMPLE_PERIOD
    rms = {"rmse": error, "current_rate_rms": rate}
    squares = {key: float(np.sqrt(np.mean(each**2))) if len(each) else np.nan for key, each in rms.items()}
    return {**squares, "tripped": tripped, **means}


def drawn_gains(base: tuple[float, float], seed: int) -> Chooser:
    """Gains drawn anew at each policy step."""
    generator = np.random.default_rng(seed)

    def choose(samples: FloatArray) -> FloatArray:
        columns = [generator.uniform(*span, len(samples)) - own for span, own in zip(DRAWN, base, strict=True)]
        return np.column_stack(columns)

    return choose


def gain_rows(name: str, config: TruthConfig, made: tuple[LearnedMetric, Path] | None) -> list[dict[str, Any]]:
    """Rows of drawn gains at each C_1, each reference, without and with the filter of the bench file."""
    rows = []
    for c_1 in COMPENSATIONS:
        law = replace(BoxConfig().compensated, velocity_compensation=c_1, velocity_compensation_max=1.0)
        box = replace(BoxConfig(), compensated=law)
        kinds: dict[str, FleetFilter | None] = {"none": None}
        if made is not None:
            kinds["own"] = fleet_filter_at(c_1, *made)
        for told, filters in kinds.items():
            choose, compensator = drawn_gains((law.base_kp, law.base_ki), 1), Compensator(len(CASES), law=law)
            done = measure(config, CASES, choose, compensator, box=box, filters=filters)
            rows += [{"truth": name, "C_1": c_1, "filter": told, **row} for row in done]
    return rows


def fleet_filter_at(c_1: float, metrics: LearnedMetric, model: Path) -> FleetFilter:
    """The filter of a file for every run, with its metric for this C_1, or the last one."""
    fit = [one for one in metrics.certificates if abs(one.velocity_compensation - c_1) <= SAME]
    chosen = (fit or metrics.certificates)[-1]
    return loop_fleet_filter(loop_parts(chosen, Bench.load(model), Bench.nominal()), len(CASES))


def table(title: str, rows: Sequence[dict[str, Any]], keys: Sequence[str], shares: Sequence[str]) -> Table:
    """Interquartile mean (worst) RMSE [N] by reference, trips and mean shares, of each combination of `keys`."""
    units = {
        **dict.fromkeys(keys, ""),
        **dict.fromkeys((case.name for case in CASES), "N"),
        "u' RMS": "A/s",
        "trips": "",
    }
    made = Table({**units, **dict.fromkeys(shares, "%")}, title=title)
    for group in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        own = [row for row in rows if tuple(row[key] for key in keys) == group]
        cells: dict[str, Any] = dict(zip(keys, group, strict=True))
        for case in CASES:
            values = np.array([row["rmse"] for row in own if row["reference"] == case.name])
            cells[case.name] = f"{interquartile_mean(values):.1f} ({np.nanmax(values):.0f})"
        cells["u' RMS"] = f"{interquartile_mean(np.array([row['current_rate_rms'] for row in own])):.3f}"
        cells["trips"] = f"{sum(row['tripped'] for row in own)} of {len(own)}"
        made.add(**cells, **{share: f"{np.mean([row[share] for row in own]):.2g}" for share in shares})
    return made


@command(ValueError, OSError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.compensated_filter", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--folder", type=Path, required=True, help="of bench files and metrics; those there are taken")
    parser.add_argument("--draw", type=int, default=12, metavar="COUNT", help="drawn truths; default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default: %(default)s")
    parser.add_argument(
        "--law", choices=("both", "compensated"), default="both",
        help="of the metrics (`learn_metric --law`); without the paper's the filter corrects all gains at C_1 = 1",
    )  # fmt: skip
    parser.add_argument("--parts", nargs="+", choices=("law", "gains"), default=["law", "gains"])
    add_json_argument(parser)
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    truths = {"default": profile("default")}
    drawn = drawn_truths(asked.draw, asked.seed)
    truths |= {f"{name}_{asked.seed}": truth_from_mapping(contents) for name, contents in drawn.items()}
    shipped, rows = default_filter(), {part: list[dict[str, Any]]() for part in asked.parts}
    for name, config in progress(truths.items(), total=len(truths), label="truths", unit="truth"):
        try:
            own, metrics, model = made_for(name, config, asked.folder, asked.law)
        except ValueError as error:
            print(f"{name}: no filter: {error}", file=sys.stderr)
            own, metrics, model = None, None, None
        if "law" in rows:
            rows["law"] += law_rows(name, config, own, shipped)
        if "gains" in rows:
            rows["gains"] += gain_rows(name, config, None if metrics is None else (metrics, model))
        if asked.json:
            Path(asked.json).write_text(json.dumps(rows, indent=1) + "\n")
    for kind, of in (("default", ["default"]), ("drawn", [name for name in truths if name != "default"])):
        for part, keys, shares in (("law", ("filter",), ("mismatch", "corrected")), ("gains", ("C_1", "filter"), ())):
            own_rows = [row for row in rows.get(part, ()) if row["truth"] in of]
            if own_rows:
                table(f"{part}, {kind}: force RMSE [N], interquartile mean (worst)", own_rows, keys, shares).show()


if __name__ == "__main__":
    main()
