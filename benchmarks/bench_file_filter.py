# SPDX-License-Identifier: Apache-2.0
"""The filter on a bench file: metric made anew by `learn_metric --model BENCH.yaml`, then runs on the emulated bench.

The emulator's truth is changed (spring, supply, valve gain, overlap); the bench file says the change and the effects
that a diagnosis finds, in the model's own forms; the box keeps to the nominal bench.yaml. Off-line, sample by sample,
as `benchmarks.model_mismatch changes`, but from the beginning: nothing changes while it runs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from benchmarks._changing_bench import outcome, play
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import CorrectionStatus, ReferenceSignal, Waveform
from hydro_filter.controller.factory import FilterChoice, warm_up
from hydro_filter.controller.filter import Result
from hydro_filter.controller.loop_filter import LoopFilter
from hydro_filter.model.sample import Sample
from hydro_filter.precompile import FOUND
from hydro_filter.validation.plants import modified_truth
from hydro_filter.validation.trial import Corrector
from hydro_policy.evaluation.controllers import FixedGains
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench

DEADBAND = {"id": "valve_deadband", "parameters": {"half_width": 5e-4}}
GAIN = {"id": "valve_gain", "parameters": {"ratio": 0.75}}

Case = tuple[Mapping[str, Any], Mapping[str, float], tuple[Mapping[str, Any], ...]]

CELL = {"sensor": "load_force", "bandwidth": 25.0, "damping": 0.55}
"""The truth's load cell, which a list of lags takes the place of."""


def _delayed(seconds: float) -> Case:
    """A dead time."""
    return (
        {"effects": {"transport_delay": {"time": seconds}}},
        {},
        ({"id": "transport_delay", "parameters": {"time": seconds}},),
    )


def _slow_pressures(bandwidth: float) -> Case:
    """Lagging sensors of both pressures."""
    sensors, numbers = ("pressure_a", "pressure_b"), {"bandwidth": bandwidth, "damping": 0.7}
    return (
        {"effects": {"sensor_lag": [CELL, *({"sensor": one, **numbers} for one in sensors)]}},
        {},
        tuple({"id": "sensor_lag", "sensor": one, "parameters": numbers} for one in sensors),
    )


CASES: Mapping[str, Case] = {
    "as learned": ({}, {}, ()),
    **{
        f"spring {k:g} kN/m": ({"bench": {"spring_stiffness": 1e3 * k}}, {"spring_stiffness": 1e3 * k}, ())
        for k in (10.0, 30.0, 50.0)
    },
    **{
        f"supply {p:g} MPa": ({"bench": {"supply_pressure": 1e6 * p}}, {"supply_pressure": 1e6 * p}, ())
        for p in (10.0, 13.0)
    },
    "valve gain -25 %": ({"effects": {"valve_gain": {"ratio": 0.75}}}, {}, (GAIN,)),
    **{f"dead time {1e3 * t:g} ms": _delayed(t) for t in (1e-3, 2e-3)},
    **{f"pressure sensors {f:g} Hz": _slow_pressures(f) for f in (200.0, 80.0)},
    "deadband 0.5 mA": ({"effects": {"valve_deadband": {"half_width": 5e-4}}}, {}, (DEADBAND,)),
}
"""Of each bench: the truth's change, and the bench file's numbers and further effects."""
REFERENCE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
BEGIN, SECONDS = 2000, 6.0
FILE_NAME = str.maketrans(" /", "__", "%")
COLUMNS = {
    "bench": "",
    "seed": "of the noise, and of the recording where there is one",
    "gains": "asked for: K_p, K_i",
    "filter": "none, or on the bench file with its own metric",
    "rmse": "N, of f_r - f_l after 2 s",
    "peak": "N, largest |f_r - f_l| after 2 s",
    "jump": "mA, largest change of the current in 1 ms",
    "tripped": "whether the box did",
    "mismatch": "%, samples with that status",
    "corrected": "%, samples with a correction",
    "call_p50": "us, a decision",
    "call_p99": "us",
    "range": "1/s, certified K_p",
    "violated": "%, held-out samples of the certified range that do not decay",
    "made_in": "s, for the metric",
}


class Timed:
    """A filter that notes how long it takes."""

    def __init__(self, timed: LoopFilter) -> None:
        self.filter = timed
        self.took: list[float] = []

    def reset(self) -> None:
        """See `Corrector`."""
        self.filter.reset()

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """See `Corrector`."""
        began = time.perf_counter()
        result = self.filter.correct(sample, age)
        self.took.append(time.perf_counter() - began)
        return result


def bench_file(case: Case, path: Path) -> Path:
    """Write the bench file of a case."""
    _, numbers, effects = case
    content = Bench.nominal().to_mapping() | dict(numbers) | {"effects": [dict(one) for one in (*FOUND, *effects)]}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def metric(model: Path, folder: Path, law: str = "paper") -> tuple[Path, dict[str, Any]]:
    """The metric of a bench file, and what is said of it (raises ValueError with the command's own words)."""
    out, table = folder / f"{model.stem}.safetensors", folder / f"{model.stem}.json"
    began = time.monotonic()
    words = ["--out", str(out), "--model", str(model), "--epochs", "0", "--law", law, "--json", str(table)]
    code = "from hydro_filter.training.learn_metric import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1].removeprefix("error: "))
    rows = yaml.safe_load(table.read_text(encoding="utf-8"))["rows"]
    solved = (row for row in rows if row["metric"].startswith("solved"))
    violated = next(row["violated"] for row in solved if row["gains"] == "certified")
    span = done.stderr.rpartition("certified range: K_p ")[2].split(" 1/s")[0]
    return out, {"range": span, "violated": violated, "made_in": time.monotonic() - began}


def row(plant: TruthPlant, gains: tuple[float, float], corrector: Corrector | None, seed: int) -> dict[str, Any]:
    """What one run came to."""
    own = FixedGains(*gains)
    states, statuses = play(plant, Bench.nominal(), own, REFERENCE, corrector=corrector, seconds=SECONDS, seed=seed)
    done = outcome(states, statuses, BEGIN)
    settled = np.asarray(statuses[BEGIN:])
    wrong = 100.0 * float((settled == CorrectionStatus.MISMATCH).mean()) if len(settled) else np.nan
    acting = (CorrectionStatus.MODIFIED, CorrectionStatus.RELAXED)
    corrected = 100.0 * float(np.isin(settled, [int(one) for one in acting]).mean()) if len(settled) else np.nan
    figures = {"rmse": done.rmse, "peak": done.peak, "jump": done.jump, "tripped": done.tripped}
    return {"gains": f"{gains[0]:g}, {gains[1]:g}", **figures, "mismatch": wrong, "corrected": corrected}


def made_for(name: str, folder: Path) -> tuple[LoopFilter, dict[str, Any]] | None:
    """The filter on a case's bench file and what is said of its metric; None, and why on stderr: it has none."""
    model = bench_file(CASES[name], folder / f"{name.translate(FILE_NAME)}.yaml")
    try:
        file, said = metric(model, folder)
        return loaded(file, model), said
    except ValueError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return None


def loaded(metric_file: Path, model: Path) -> LoopFilter:
    """The filter of these files, compiled and ready (raises ValueError where they do not belong together)."""
    choice = FilterChoice(bench=Bench.nominal(), metric=str(metric_file), model=model)
    if trouble := choice.trouble():
        raise ValueError(trouble)
    made = choice.make(choice.default_settings())
    assert isinstance(made, LoopFilter)
    warm_up(made, choice.bench)
    return made


def add_runs(
    table: Table,
    name: str,
    plant: TruthPlant,
    filtering: tuple[LoopFilter, dict[str, Any]] | None,
    told: str,
    seed: int = 0,
) -> None:
    """Add a bench's rows: without a filter, and under wide gains behind this one, if there is one, called `told`."""
    nothing = dict.fromkeys(list(COLUMNS)[10:], np.nan)
    for gains in ((90.0, 15.0), (250.0, 15.0), (300.0, 30.0)):
        table.add(bench=name, seed=seed, filter="none", **row(plant, gains, None, seed), **nothing)
        if filtering is not None and gains[0] > 90.0:
            made, said = filtering
            timed = Timed(made)
            found = row(plant, gains, timed, seed)
            p50, p99 = 1e6 * np.quantile(timed.took, (0.5, 0.99))
            table.add(bench=name, seed=seed, filter=told, **found, call_p50=p50, call_p99=p99, **said)


def table_of(names: list[str], folder: Path) -> Table:
    """All rows."""
    table = Table(COLUMNS, title="The filter on a bench file")
    for name in progress(names, label="benches", unit="bench"):
        add_runs(table, name, TruthPlant(modified_truth(CASES[name][0])), made_for(name, folder), "bench file")
    return table


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_file_filter", description=__doc__)
    parser.add_argument("--bench", nargs="+", default=list(CASES), choices=list(CASES), help="default: all")
    add_json_argument(parser)
    asked = parser.parse_args()
    with TemporaryDirectory() as folder:
        table_of(asked.bench, Path(folder)).show(asked.json)


if __name__ == "__main__":
    main()
