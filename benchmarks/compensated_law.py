# SPDX-License-Identifier: Apache-2.0
"""The compensated law's own tables: python -m benchmarks.compensated_law STUDY [--draw COUNT --seed S] [--json FILE].

margins    the law as it is over drawn truths and the default one, by believed valve gain and delay to the valve
effects    each effect of the default truth doubled (bandwidths halved)
specimen   the load's own force, load cell not known, as a diagnosis of two recordings finds it, known, 20 % wrong;
           rmse and ratio: of the measured force where the cell is not known, largest true_rmse as diagnosed over it;
           share: largest true_rmse with the cell 20 % wrong over that of a cell not known
changes    spring, supply and valve of the default truth changed in mid-run
endurance  the default truth for --hours at references that change every 20 s

No filter; the emulator's plant without a clock. Interquartile mean (worst) of the force RMSE [N] over the truths.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks._drawn_truths import drawn_truths
from benchmarks._report import parser
from benchmarks._truth_fleet import truth_fleet
from benchmarks.controllers import SETTINGS, compensated, held, load_cell, table
from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.cli import jobs
from hydro_bridge.cli.console import Table, command
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import Flag, Law, Waveform
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.report.corrected_bench import write_corrected
from hydro_policy.compensation.estimator import ADAPTS, STEP, Compensator, LoadCell
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import DEAD_TIME_MAX
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import TruthConfig, profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench

DOUBLED: Mapping[str, Mapping[str, Any]] = {
    "as it is": {},
    "dry friction": {"friction_coulomb": {"force": 24.0, "form": "lugre"}},
    "breakaway": {"friction_stribeck": {"breakaway_force": 10.0, "velocity": 0.01}},
    "presliding": {"friction_presliding": {"stiffness": 1e6}},
    "leak": {"leakage_internal": {"coefficient": 2e-13}},
    "spool": {"valve_lag": {"bandwidth": 55.0, "damping": 1.2, "rate_limit": 3.0}},
    "load cell": {"sensor_lag": [{"sensor": "load_force", "bandwidth": 12.5, "damping": 0.55}]},
}
CHANGES: Mapping[str, Mapping[str, Any]] = {
    "spring x 0.5": {"spring_stiffness": {"ratio": 0.5}},
    "spring x 2": {"spring_stiffness": {"ratio": 2.0}},
    "supply x 0.65": {"supply_pressure": {"ratio": 0.65}},
    "valve gain x 0.75": {"valve_gain": {"ratio": 0.75}},
    "valve gain x 1.25": {"valve_gain": {"ratio": 1.25}},
}
REFERENCE_TIME = 20.0
"""s of each reference of `endurance`, of which the first `SETTINGS.settle` do not count."""
RECORDED = (
    [Segment(seconds=10.0, waveform="multisine", amplitude=200.0, frequency=0.5, kp=150.0, ki=15.0),
     Segment(seconds=10.0, waveform="sine", amplitude=200.0, frequency=1.5, kp=150.0, ki=15.0)],
    [Segment(seconds=10.0, waveform="smooth_step", amplitude=150.0, frequency=0.5, kp=150.0, ki=15.0),
     Segment(seconds=10.0, waveform="sine", amplitude=200.0, frequency=1.0, kp=150.0, ki=15.0)],
)  # fmt: skip
"""What a diagnosis is given, under the paper's law: to fit, and held out."""
CAUTIOUS = 1.6
"""Times the nominal valve's flow, which the box believes meanwhile: nothing trips."""


class Condition(NamedTuple):
    """What the box believes and is given."""

    name: str
    valve_gain: float = 1.0
    """Believed, over the shipped bench.yaml's: C_2."""
    dead_time: int = 0
    """Of the valve, samples."""


AS_IT_IS = Condition("as it is")
MARGIN_CONDITIONS = (
    AS_IT_IS,
    *(Condition(f"valve gain x {factor:g}", factor) for factor in (0.3, 0.4, 0.5, 0.6, 0.8, 1.25, 1.6, 2.5)),
    *(Condition(f"{late} ms late", dead_time=late) for late in (1, 2, 4, 6, DEAD_TIME_MAX)),
)


class Job(NamedTuple):
    """One truth under one condition."""

    label: str
    config: TruthConfig
    condition: Condition


def run_job(job: Job) -> list[dict[str, Any]]:
    """Rows of this truth on the references of `evaluate`."""
    scale, usual = job.condition.valve_gain, BoxLaw()
    law = replace(usual, valve_gain_scale=scale, valve_gain_scale_min=min(scale, usual.valve_gain_scale_min))
    rows = compensated(job.config, SETTINGS.cases, law, dead_time=job.condition.dead_time)
    return [{"law": job.label, "condition": job.condition.name, **row} for row in rows]


def tabulated(asked: argparse.Namespace, wanted: Sequence[Job]) -> Table:
    """A row for each law and condition."""
    rows = [row for found in on_truths(asked, run_job, wanted) for row in found]
    return table(rows, SETTINGS.cases, ("law", "condition"))


def on_truths(asked: argparse.Namespace, function: Callable[[Any], Any], wanted: Sequence[Any]) -> list[Any]:
    """What the function gives of each, in their order."""
    numbered = {str(number): (each,) for number, each in enumerate(wanted)}
    return [*jobs.complete(function, numbered, **jobs.where(asked), label="truths", unit="truth").values()]


def margins(asked: argparse.Namespace) -> Table:
    """The law's margins."""
    truths = {"default": [profile("default")], f"{asked.draw} drawn": drawn(asked)}
    return tabulated(asked, [
        Job(name, config, condition)
        for name, configs in truths.items() for condition in MARGIN_CONDITIONS for config in configs
    ])  # fmt: skip


def effects(asked: argparse.Namespace) -> Table:
    """Each effect doubled."""
    return tabulated(asked, [Job(name, truth(changed), AS_IT_IS) for name, changed in DOUBLED.items()])


def specimen(asked: argparse.Namespace) -> Table:
    """A row for each truth, the default one first: cell as it is and as found, mean errors of the six references."""
    beliefs = dict.fromkeys(("not known", "diagnosed", "known", "x 0.8", "x 1.2"), "N, true_rmse")
    made = Table({"truth": "", "cell": "Hz, -", "found": "Hz, -", **beliefs, "rmse": "N", "ratio": "", "share": ""})
    configs = [profile("default"), *drawn(asked)]
    for number, (cells, rows) in enumerate(on_truths(asked, specimen_of, configs)):
        felt = {name: np.array([row["true_rmse"] for row in own]) for name, own in rows.items()}
        rmse = np.array([row["rmse"] for row in rows["not known"]])
        wrong = np.maximum(felt["x 0.8"], felt["x 1.2"])
        said = {key: "none" if (cell := cells[belief]) is None else f"{cell.bandwidth:.1f}, {cell.damping:.2f}"
                for key, belief in (("cell", "known"), ("found", "diagnosed"))}  # fmt: skip
        said |= {name: f"{each.mean():.2f}" for name, each in felt.items()} | {"rmse": f"{rmse.mean():.2f}"}
        said["ratio"] = f"{(felt['diagnosed'] / rmse).max():.2f}"
        said["share"] = f"{(wrong / felt['not known']).max():.2f}"
        made.add(truth=str(number - 1) if number else "default", **said)
    return made


def specimen_of(config: TruthConfig) -> tuple[dict[str, LoadCell | None], dict[str, list[dict[str, Any]]]]:
    """The load cell by belief, and rows of `evaluate`'s references under it."""
    known = load_cell(config)
    with TemporaryDirectory() as folder:
        found = LoadCell.load(diagnosed(config, Path(folder)))
    cells = {"not known": None, "diagnosed": found, "known": known}
    for factor in (0.8, 1.2):
        cells[f"x {factor:g}"] = known and replace(known, bandwidth=factor * known.bandwidth)
    return cells, {name: compensated(config, SETTINGS.cases, cell=cell) for name, cell in cells.items()}


def diagnosed(config: TruthConfig, folder: Path) -> Path:
    """`corrected.yaml` in the folder, of a diagnosis of this truth's two recordings."""
    bench = Bench.nominal()
    believed = replace(bench, valve_nominal_flow=CAUTIOUS * bench.valve_nominal_flow)
    with TemporaryDirectory() as place:
        bags = [Path(place) / name for name in ("fitted", "held_out")]
        for seed, (bag, segments) in enumerate(zip(bags, RECORDED, strict=True)):
            with BagWriter(bag) as writer:
                writer.write_states(record_offline(config, segments, bench=believed, seed=seed).states)
        write_corrected(diagnose(bags[:1], holdout=bags[1:]).corrected, (), folder / "corrected.yaml")
    return folder / "corrected.yaml"


def changes(asked: argparse.Namespace) -> Table:
    """RMSE in the 2 s before a change at 4 s, the first second behind it, and from 2 s behind it on."""
    settings = replace(SETTINGS, measure=6.0)
    windows = {"before": (2.0, 4.0), "first second": (4.0, 5.0), "2 s later": (6.0, 8.0)}
    cases = settings.cases
    made = Table({"change": "", "window": "", **dict.fromkeys((case.name for case in cases), "N"), "trips": ""})
    for name, changed in CHANGES.items():
        fleet, plant = truth_fleet(len(cases), profile("default")), TruthPlant(truth(changed))
        sums = {window: np.zeros(len(cases)) for window in windows}
        tripped = np.zeros(len(cases), bool)
        law = BoxLaw()
        runs = vector_runs.run(
            fleet, cases, held((law.base_kp, law.base_ki), law), settings, 0, Compensator(len(cases), law=law)
        )
        for number, step in enumerate(runs):
            if number * STEP == windows["before"][1]:
                fleet.rows.arrays.parameters[:] = plant.parameters[0]
            error = step.samples["reference_force"] - step.samples["load_force"]
            for window, (first, last) in windows.items():
                sums[window] += (first <= number * STEP < last) * np.mean(error * error, axis=1)
            tripped |= np.any(step.samples["flags"] & Flag.TRIPPED, axis=1)
        for window, (first, last) in windows.items():
            rmse = np.sqrt(sums[window] * STEP / (last - first))
            cells = {case.name: f"{value:.1f}" for case, value in zip(cases, rmse, strict=True)}
            made.add(change=name, window=window, **cells, trips=str(int(tripped.sum())))
    return made


def endurance(asked: argparse.Namespace) -> Table:
    """RMSE and coefficients by hours, each printed as it ends; benches side by side, with references of their own."""
    count, generator = asked.benches, np.random.default_rng(asked.seed)
    fleet, law = truth_fleet(count, profile("default")), BoxLaw()
    compensator = Compensator(count, law=law)
    for index in range(count):
        fleet.begin(index, SETTINGS.cases[0].signal, asked.seed + index, law=Law.COMPENSATED)
    waves = {"sines": Waveform.SINE, "multisines": Waveform.MULTISINE, "steps": Waveform.SMOOTH_STEP}
    scales = {"a_0": 1.0, "a_1 [ms]": 1e3, "a_2 [1e-3 s^2]": 1e3, "a_3 [N]": 1.0}
    made = Table({"to": "h", **dict.fromkeys(waves, "N"), **dict.fromkeys(scales, ""), "trips": ""})
    for end in np.minimum(np.arange(1.0, asked.hours + 1.0), asked.hours):
        squares, steps, trips, seen = np.zeros(len(waves)), np.zeros(len(waves)), 0, []
        for number in range(round((end - len(made.rows)) * 3600.0 / STEP)):
            since = number % round(REFERENCE_TIME / STEP)
            if since == 0:
                kinds = generator.integers(len(waves), size=count)
                for wanted, kind in zip(fleet.commands["reference"], kinds, strict=True):
                    wanted["waveform"], wanted["frequency"] = list(waves.values())[kind], generator.uniform(0.3, 2.0)
                    wanted["amplitude"], wanted["offset"] = generator.uniform((50.0, -50.0), (250.0, 50.0))
            samples = fleet.step(np.zeros((count, 2)), compensator.coefficients)
            active = np.all(samples["flags"] & ADAPTS == Flag.ARMED, axis=1)
            compensator.step(fleet.compensated, samples["load_force"], active, samples["reference_force_rate"])
            trips += np.count_nonzero(samples["flags"] & Flag.TRIPPED)
            if since * STEP >= SETTINGS.settle:
                error = samples["reference_force"] - samples["load_force"]
                np.add.at(squares, kinds, np.mean(error * error, axis=1))
                np.add.at(steps, kinds, 1)
                seen.append(compensator.coefficients.copy())
        all_seen = np.array(seen)
        rmse = {name: f"{value:.2f}" for name, value in zip(waves, np.sqrt(squares / steps), strict=True)}
        ranges = {
            name: f"{all_seen[..., k].min() * scale:.3g} to {all_seen[..., k].max() * scale:.3g}"
            for k, (name, scale) in enumerate(scales.items())
        }
        made.add(to=f"{end:g}", **rmse, **ranges, trips=str(trips))
        print(made.rows[-1], file=sys.stderr, flush=True)
    return made


def truth(changed: Mapping[str, Any]) -> TruthConfig:
    """The default truth with these effects."""
    return truth_from_mapping({"profile": "default", "effects": dict(changed)})


def drawn(asked: argparse.Namespace) -> list[TruthConfig]:
    """The truths asked for."""
    return [truth_from_mapping(contents) for contents in drawn_truths(asked.draw, asked.seed).values()]


STUDIES: dict[str, Callable[[argparse.Namespace], Table]] = {
    study.__name__: study for study in (margins, effects, specimen, changes, endurance)
}


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    options = parser("compensated_law", __doc__)
    options.add_argument("study", choices=STUDIES)
    options.add_argument("--draw", type=int, default=40, metavar="COUNT", help="truths; default: %(default)s")
    options.add_argument("--seed", type=int, default=1, help="of the draw; default: %(default)s")
    options.add_argument("--benches", type=int, default=1, help="of endurance, side by side; default: %(default)s")
    options.add_argument("--hours", type=float, default=24.0, help="of endurance; default: %(default)s")
    jobs.add_arguments(options)
    asked = options.parse_args()
    STUDIES[asked.study](asked).show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
