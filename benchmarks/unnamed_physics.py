# SPDX-License-Identifier: Apache-2.0
"""The learned model where the bench has physics that no effect names: predictions of 70 samples, in noise floors.

The plant is that of `benchmarks.beyond_the_table`, which shares no code with the model; kinds of its development half,
and nothing missing (`clean`). A case is two runs of 25 s, which everything is learnt from, and a third with a reference
and noise of its own, which everything is judged by. bench.yaml is what the user believes.

    python -m benchmarks.unnamed_physics --kinds drag_square valve_curve --seeds 1 2 3 --json unnamed.json

Ctrl-C loses one model at most: run it again to go on. OUT/SEED/CASE/ holds the bench files and what they leave.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.beyond_the_table.__main__ import carried_out
from benchmarks.beyond_the_table.cases import Case, drawn
from benchmarks.beyond_the_table.kinds import KINDS
from benchmarks.beyond_the_table.recordings import SECONDS, simulated
from benchmarks.foreign_truth.recordings import FORCE_NOISE, PRESSURE_NOISE, QUANTUM, RUNS, states_of
from benchmarks.paper import network
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress, writable_folder
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.signals import FloatArray
from hydro_sim.files import recordings
from hydro_sim.files.recordings import READING_COLUMNS, Data, Run
from hydro_sim.identification import bench_learning, evaluation
from hydro_sim.identification.bench_prediction import BenchPrediction
from hydro_sim.identification.evaluation import Predictor
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import HORIZON, READINGS

CLEAN = "clean"
NAMES = (CLEAN, *(kind.name for kind in KINDS if kind.half == "dev"))
DEFAULT = (CLEAN, "drag_square", "seal_drop", "hose_memory", "leak_by_motion", "valve_curve", "spring_hysteresis")
"""Two kinds in the motion, one in a pressure, one in both, one in the valve and one in the load."""
FLOOR = np.array([FORCE_NOISE, FORCE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE, QUANTUM / math.sqrt(12.0)])
"""What the readings' noise leaves of a perfect prediction, RMS, SI units, shape (5,)."""
STRIDE = 37
SUSPECTS: dict[str, dict[str, float]] = {
    "friction_viscous": {"coefficient": 0.0},
    "friction_coulomb": {"force": 1.0},
    "leakage_internal": {"coefficient": 0.0},
    "valve_gain": {"ratio": 1.0},
    "bulk_modulus": {"ratio": 1.0},
    "moving_mass": {"mass": 0.0},
    "spring_stiffness": {"ratio": 1.0},
}
"""Effects that a user would name who suspects everything usual."""
MODELS = {
    "bench.yaml": "the equations with the numbers that the user believes",
    "network": "the paper's, two layers of 32",
    "names": "bench.yaml with seven usual effects, learnt; no closure",
    "diagnosed": "the corrected.yaml of `diagnose`, closures included",
    "learnt": "corrected.yaml refined by `learn`, if it has anything to learn",
}
COLUMNS = {
    "case": "", "seed": "", "model": "; ".join(f"{name}: {text}" for name, text in MODELS.items()),
    **dict.fromkeys(READINGS, "RMSE of 70-sample predictions of the third run over the noise"),
    "worst": "of the five", "cpu": "s of processor time to make it", "terms": "effects and closures of the bench file",
}  # fmt: skip


def case_of(name: str, seed: int) -> Case:
    """The case of a kind alone that `beyond_the_table` draws from a seed, or one in which nothing is missing."""
    if name == CLEAN:
        return Case("clean_0", None, seed=1000 * seed)
    return drawn("dev", 1, seed, [name])[0]


def recorded(case: Case, seconds: float = SECONDS) -> tuple[Data, Run]:
    """The two runs that models are learnt from, and the one that they are judged by."""
    logs = {name: states_of(simulated(case, number, seconds)) for number, name in enumerate(RUNS)}
    third = states_of(simulated(replace(case, seed=case.seed + 10), len(RUNS) - 1, seconds))
    return recordings.split(logs), recordings.runs("third", third)[0]


def left(model: Bench | Predictor, data: Data, judge: Run) -> FloatArray:
    """RMSE of predictions of the judging run over the noise, shape (5,).

    Predictions start from the model's own estimates; how far a bench's filter trusts it is chosen by the learnt runs.
    """
    predictor: Predictor = BenchPrediction(model, data.validation) if isinstance(model, Bench) else model
    found = evaluation.errors(predictor, predictor.estimate(judge), judge, judge.x, HORIZON, STRIDE)
    return np.asarray(found.rmse[list(READING_COLUMNS)] / FLOOR)


def made(name: str, case: Case, folder: Path, data: Data) -> tuple[Bench | Predictor, float | None]:
    """A model, and the s of processor time that it took if they are told elsewhere."""
    if name == "bench.yaml":
        return Bench.nominal(), 0.0
    if name == "network":
        model = network.NetworkModel.untrained(data.training, (32, 32), 0)
        network.train(model, data, batch=256, seed=0, epochs=1000)
        return model, None
    if name == "names":
        effects = tuple({"id": one, "parameters": values} for one, values in SUSPECTS.items())
        return bench_learning.learn(replace(Bench.nominal(), effects=effects), data).bench, None
    result = carried_out(case, folder / "diagnosis", seconds=SECONDS)
    if result["report"] is None:
        raise UserError(f"{case.name}: the diagnosis refused: {result['said']}")
    bench = Bench.load(folder / "diagnosis" / "report" / "corrected.yaml")
    if name == "diagnosed":
        return bench, result["cpu"]
    return (bench_learning.learn(bench, data).bench, None) if bench.terms else (bench, 0.0)


def judged(case: Case, folder: Path) -> Iterator[dict[str, Any]]:
    """Rows of a case; what is in its folder is not done again."""
    kept, rows, runs = folder / "models.json", {}, None
    if kept.exists():
        rows = json.loads(kept.read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    for name in MODELS:
        if name not in rows:
            runs = runs or recorded(case)
            began = time.process_time()
            model, told = made(name, case, folder, runs[0])
            spent = time.process_time() - began if told is None else told
            rows[name] = {"left": left(model, *runs).tolist(), "cpu": round(spent, 1), "terms": ""}
            if isinstance(model, Bench):
                rows[name]["terms"] = "; ".join(map(_told, model.terms))
                write_whole(folder / f"{name}.yaml", yaml.safe_dump(model.to_mapping(), sort_keys=False).encode())
            write_whole(kept, (json.dumps(rows) + "\n").encode())
        yield {"model": name, **rows[name]}


def _told(term: Any) -> str:
    words = [str(value) for key, value in term.items() if key != "parameters"]
    return f"{' '.join(words)} ({', '.join(f'{value:.4g}' for value in term['parameters'].values())})"


@command(ValueError)
def main() -> None:
    """Run what is asked for and print the table."""
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.unnamed_physics",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--kinds", nargs="+", choices=NAMES, default=DEFAULT, metavar="KIND",
                         help=f"of: {', '.join(NAMES)} (default: {', '.join(DEFAULT)})")  # fmt: skip
    options.add_argument("--seeds", nargs="+", type=int, default=[1], metavar="S", help="default: 1")
    options.add_argument("--out", type=writable_folder, default=Path("runs/unnamed_physics"), metavar="DIR",
                         help="where bench files and results are kept (default: runs/unnamed_physics)")  # fmt: skip
    add_json_argument(options)
    asked = options.parse_args()
    if min(asked.seeds) < 0:
        raise UserError("--seeds of at least 0 are meant")
    table = Table(COLUMNS, title=f"{HORIZON}-sample predictions over the noise")
    cases = [(case_of(name, seed), seed) for seed in asked.seeds for name in asked.kinds]
    for case, seed in progress(cases, label="unnamed physics", unit="case"):
        for row in judged(case, asked.out / str(seed) / case.name):
            errors = row.pop("left")
            table.add(case=case.name, seed=seed, **row, **dict(zip(READINGS, errors, strict=True)), worst=max(errors))
    table.show(asked.json)


if __name__ == "__main__":
    main()
