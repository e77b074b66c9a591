# SPDX-License-Identifier: Apache-2.0
"""What the filter does where its model is not this bench's: false alarms, time until told, and what the force does.

Off-line, sample by sample, on the emulated bench and the learned simulation: box, guard (opened to all that the box
takes), filter. The tables of filter_figures.md:

alarms     benches that are what was learned, for an hour: references and gains at random, other noise for each
changes    a bench that changes while it runs, the filter starting with the shipped model: when it is told, and the
           error from a second after the change on; fixed (90, 15) without a filter, the filter as it was before it
           watched itself, and as it is
foreign    another cylinder, spring and supply, known to the box and not to the filter
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _false_alarms
from benchmarks._changing_bench import ToldAtOnce, Unwatched, outcome, play
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_filter.controller.innovations import EQUATIONS
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.validation.plants import ChangingPlant, modified_truth
from hydro_filter.validation.trial import Corrector
from hydro_policy.evaluation.controllers import Controller, FixedGains, policy_controller
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant

CHANGES: Mapping[str, Mapping[str, Any]] = {
    **{f"spring {k:g} kN/m": {"bench": {"spring_stiffness": 1e3 * k}} for k in (10.0, 14.0, 28.0, 30.0, 40.0, 50.0)},
    **{f"supply {p:g} MPa": {"bench": {"supply_pressure": 1e6 * p}} for p in (10.0, 13.0)},
    "valve gain -25 %": {"effects": {"valve_gain": {"ratio": 0.75}}},
    "piston area +30 %": {"bench": {"piston_area": 2.6e-4}},
}
"""What the learned bench (20 kN/m, 16 MPa) becomes."""
FOREIGN: Mapping[str, float] = {"piston_area": 3e-4, "spring_stiffness": 3.5e4, "supply_pressure": 12e6}
SHIPPED = Path(str(resources.files("hydro_policy") / "data" / "pretrained_wide" / "policy.safetensors"))
CHANGE, BEGIN, SECONDS = 2500, 3500, 6.5
"""Samples of the change and of the error's begin; s of a run."""
REFERENCES = {
    f"{a:g} N, {f:g} Hz": ReferenceSignal(waveform=Waveform.SINE, amplitude=a, frequency=f)
    for a, f in ((300.0, 1.0), (200.0, 0.5), (300.0, 2.0), (50.0, 0.5))
}
COLUMNS = {
    "bench": "",
    "reference": "",
    "gains": "asked for",
    "filter": "none, before (believes its model), now, told (of the change, in the sample in which it happens)",
    "told": "ms from the change (foreign: from the arming) to the first MISMATCH",
    "rmse": "N, of f_r - f_l from a second after the change on",
    "worst": "N, RMSE of the worst second from the change on",
    "peak": "N, largest |f_r - f_l| from the change on",
    "jump": "mA, largest change of the current in 1 ms",
    "tripped": "whether the box did",
}


def controllers() -> list[Controller]:
    """Who asks for wide gains."""
    policy = policy_controller(SHIPPED)
    policy.name = "wide policy"
    return [FixedGains(250.0, 15.0), FixedGains(300.0, 30.0), policy]


def row(
    labels: dict[str, str], plant: Plant, bench: Bench, controller: Controller, reference: ReferenceSignal,
    corrector: Corrector | None, change: int,
) -> dict[str, Any]:  # fmt: skip
    """One line."""
    states, statuses = play(plant, bench, controller, reference, corrector=corrector, seconds=SECONDS)
    whole, settled = outcome(states, statuses, change), outcome(states, statuses, change, BEGIN)
    figures = asdict(whole) | {"rmse": settled.rmse, "worst": whole.worst_second, "told": 1e3 * whole.told}
    if whole.early:
        raise AssertionError(f"{labels}: told before the change")
    return {**labels, "gains": controller.name, **{name: figures[name] for name in list(COLUMNS)[4:]}}


def lines(
    label: str, plant: Plant, bench: Bench, reference: str, asking: list[Controller], change: int
) -> Iterator[dict[str, Any]]:
    """The rows of one bench under one reference."""
    signal, watched = REFERENCES[reference], default_filter()
    filters: dict[str, Corrector | None] = {"before": Unwatched(watched), "now": watched}
    if change == 0:
        filters = {"none": None, **filters}
    else:
        filters["told"] = ToldAtOnce(watched, change)
    fixed = {"bench": label, "reference": reference}
    yield row({**fixed, "filter": "none"}, plant, bench, FixedGains(90.0, 15.0), signal, None, change)
    for controller in asking:
        for name, corrector in filters.items():
            yield row({**fixed, "filter": name}, plant, bench, controller, signal, corrector, change)


def alarms(minutes: float, seed: int) -> Table:
    """The first table."""
    columns = {"plant": "", "minutes": "of bench time", "alarms": "samples", "tripped": "benches"}
    table = Table(
        {**columns, **dict.fromkeys(EQUATIONS, "largest sum; 50 is told")}, title="Nothing is wrong: false alarms"
    )
    for plant in ("emulator", "sim"):
        found = _false_alarms.run(plant, minutes, seed)
        highest = dict(zip(EQUATIONS, np.asarray(found.highest).tolist(), strict=True))
        table.add(plant=plant, minutes=found.minutes, alarms=found.alarms, tripped=found.tripped, **highest)
    return table


def changes(names: list[str], references: list[str]) -> Table:
    """The second table."""
    table = Table(COLUMNS, title="A bench that changes while it runs")
    for name in progress(names, label="changes", unit="bench"):
        for reference in references:
            plant = ChangingPlant([modified_truth({}), modified_truth(CHANGES[name])], [CHANGE])
            for line in lines(name, plant, Bench.nominal(), reference, controllers(), CHANGE):
                table.add(**line)
    return table


def foreign(references: list[str]) -> Table:
    """The third table."""
    table = Table(COLUMNS, title=f"A foreign bench: {dict(FOREIGN)}")
    bench = Bench.from_mapping(Bench.nominal().to_mapping() | dict(FOREIGN))
    for reference in references:
        plant = ChangingPlant([modified_truth({"bench": dict(FOREIGN)})], [])
        for line in lines("foreign", plant, bench, reference, controllers(), 0):
            table.add(**line)
    return table


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.model_mismatch", description=__doc__)
    parser.add_argument("what", nargs="?", default="changes", choices=("alarms", "changes", "foreign"), help="which "
                        "table, default changes")  # fmt: skip
    parser.add_argument("--minutes", type=float, default=60.0, help="of alarms, each plant, default 60")
    parser.add_argument("--seed", type=int, default=1, help="of alarms: noise, references and gains, default 1")
    parser.add_argument("--bench", nargs="+", default=list(CHANGES), choices=list(CHANGES), help="changes, default all")
    parser.add_argument("--reference", nargs="+", default=list(REFERENCES)[:1], choices=list(REFERENCES),
                        help=f"default {next(iter(REFERENCES))}")  # fmt: skip
    add_json_argument(parser)
    asked = parser.parse_args()
    if asked.what == "alarms":
        table = alarms(asked.minutes, asked.seed)
    elif asked.what == "changes":
        table = changes(asked.bench, asked.reference)
    else:
        table = foreign(asked.reference)
    table.show(asked.json)


if __name__ == "__main__":
    main()
