# SPDX-License-Identifier: Apache-2.0
"""How much of the shipped learned bench's error is its start state's: observers with more and with less to go by.

One run of the emulator (60 s, schedule seed 21), 70-sample predictions against the noise-free log. The observer is
given the recording, with several trusts in the model, and the noise-free log itself, which no bench has.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks._learned_case import HORIZON, STRIDE, Case
from benchmarks._report import parser
from hydro_bridge.cli.console import Table
from hydro_bridge.signals import PLANT_FIELDS
from hydro_sim.files.recordings import Run
from hydro_sim.identification import evaluation
from hydro_sim.identification.evaluation import Scales
from hydro_sim.learned.model import Learned
from hydro_sim.structured.model import StructuredModel

TRUSTS = (0.1, 0.01, 0.003, 0.001)
RATE = PLANT_FIELDS.index("hydraulic_force_rate")
WORST = 12
COLUMNS = {
    "observer": "what it believes and what it is given",
    **dict.fromkeys(PLANT_FIELDS, "RMSE of 70-sample predictions against the noise-free log, over the state's range"),
    "median": "N/s, of the windows' RMSE of f_h'",
    "worst": "N/s, mean over the twelve windows whose f_h' is worst from the shipped observer's states",
    "speed": "mm/s, largest at the start of any of these twelve",
}


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    asked = parser("learned_starts", __doc__).parse_args(arguments)
    model = Learned.load().model
    assert isinstance(model, StructuredModel)
    (item,) = Case(Path(), None, 0).held_out()
    span = Scales.of(item.reference).span
    table, worst = Table(COLUMNS), None

    def add(name: str, observer: StructuredModel, run: Run) -> None:
        nonlocal worst
        how = {"horizon": HORIZON, "stride": STRIDE}
        found = evaluation.prediction_errors(model, [observer.estimate(run)], [item], recorded=False, **how)
        windows = found.by_window[:, RATE]
        worst = np.argsort(windows)[-WORST:] if worst is None else worst
        speeds = np.abs(item.run.x[evaluation.window_starts(item.run, **how)[worst], -1])
        table.add(
            observer=name, **dict(zip(PLANT_FIELDS, map(float, found.rmse / span), strict=True)),
            median=float(np.median(windows)), worst=float(windows[worst].mean()), speed=1e3 * float(speeds.max()),
        )  # fmt: skip

    add(f"shipped, trust {model.trust:g}", model, item.run)
    for trust in TRUSTS:
        add(f"trust {trust:g}", replace(model, trust=trust), item.run)
    add("noise-free readings", model, replace(item.run, x=item.reference.copy()))
    table.show(asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
