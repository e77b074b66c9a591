# SPDX-License-Identifier: Apache-2.0
"""Whether the diagnosis takes causes for mistakes of wiring, or mistakes for causes: that stage alone.

    python -m benchmarks.wiring --write wiring.jsonl                   after Ctrl-C goes on where it was
    python -m benchmarks.wiring --write wiring.jsonl --cases 300       the first 300 of the same

Every effect of the table, wrong number and other form, in three sizes, under three gains and four references, recorded
by the emulator and wired right: no repair may be preferred. Then mistakes are done to benches drawn from the same: all
must be undone. One recording of 8 s is fitted, another held out.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks import _report
from benchmarks.prove.cases import FORMS, SINGLES, VALUES, Pick, Shape, Size
from hydro_bridge.cli import jobs
from hydro_bridge.cli.console import Table, command
from hydro_bridge.signals import STATE_FIELDS
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import read_table
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.selection.outcome import NAMES
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.stage_bar import silent
from hydro_diagnosis.stages.hypotheses import read_repaired, reconsider_wiring
from hydro_diagnosis.stages.naming import search_causes
from hydro_diagnosis.stages.reading import Question
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation.schedules import Segment

SECONDS = 8.0
GAINS = (40.0, 60.0, 90.0)
REFERENCES = {
    "sine": ("sine", 280.0, 0.6),
    "multisine": ("multisine", 250.0, 0.6),
    "steps": ("smooth_step", 250.0, 0.8),
}
"""Waveform, amplitude [N], frequency [Hz]; `mix`: half of the time multisine, half steps."""
KINDS = (*REFERENCES, "mix")
MISTAKES = {
    "current, sign": "valve_current=valve_current*-1",
    "hydraulic force, sign": "hydraulic_force=hydraulic_force*-1",
    "load force, sign": "load_force=load_force*-1",
    "position, sign": "piston_position=piston_position*-1+0.08",
    "pressures exchanged": "pressure_a=pressure_b,pressure_b=pressure_a",
    "forces exchanged": "hydraulic_force=load_force,load_force=hydraulic_force",
    "position in mm": "piston_position=piston_position*1000",
    "position in counts of 5 um": "piston_position=piston_position*200000",
    "position from mid-stroke": "piston_position=piston_position-0.04",
    "pressures in bar": "pressure_a=pressure_a*1e-5,pressure_b=pressure_b*1e-5",
    "current in mA": "valve_current=valve_current*1000",
    "forces in kN": "hydraulic_force=hydraulic_force*0.001,load_force=load_force*0.001",
    "velocity for position": "piston_position=piston_velocity",
    "load force a copy": "load_force=hydraulic_force",
    "pressure a copy": "pressure_a=pressure_b",
    "pressure a 40 ms late": "pressure_a=pressure_a@-40ms",
    "current 30 ms late": "valve_current=valve_current@-30ms",
    "current 10 ms late": "valve_current=valve_current@-10ms",
    "current reversed, position in mm": "valve_current=valve_current*-1,piston_position=piston_position*1000",
}
"""What is done to right recordings, as a column map."""
SAME = 0.02
"""Share of a channel's span by which a repaired channel may differ from the right one."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One reading."""

    effect: str
    size: str
    kp: float
    reference: str
    mistake: str = ""
    repaired: bool = False
    right: bool = False
    """The channels that are read are those of the right recording; a field that is left out is not judged."""
    suspected: bool = False
    cpu: float = 0.0
    """s."""
    note: str = ""


def drawn(entry: Mapping[str, Any], size: int, turn: int) -> dict[str, Any]:
    """Values of an effect at its smallest, in between or at its largest; signs and words take turns."""
    return {key: _value(one, size, turn) for key, one in entry.items()}


def _value(one: Any, size: int, turn: int) -> Any:
    if isinstance(one, Pick):
        return one.words[turn % len(one.words)]
    if not isinstance(one, Size | Shape):
        return one
    value = float(one.low * (one.high / one.low) ** (0.5 * size))
    return one.neutral + one.signs[turn % len(one.signs)] * value if isinstance(one, Size) else value


def record(effects: Mapping[str, Any], kp: float, kind: str, path: Path, seed: int, seconds: float = SECONDS) -> None:
    """Record a bench with these effects of truth.yaml into a CSV file."""
    kinds = ("multisine", "steps") if kind == "mix" else (kind,)
    segments = [
        Segment(seconds=seconds / len(kinds), waveform=waveform, amplitude=size, frequency=rate, kp=kp, ki=10.0)
        for waveform, size, rate in (REFERENCES[one] for one in kinds)
    ]
    truth = truth_from_mapping({"profile": "nominal", "effects": dict(effects)})
    states = record_offline(truth, segments, seed=seed).states
    pd.DataFrame({"time": states["time"], **{name: states[name] for name in STATE_FIELDS}}).to_csv(path, index=False)


def cases(seed: int) -> Iterator[tuple[str, Mapping[str, Any], int, float, str]]:
    """Name, effects, size, gain and reference of all cases, in random order."""
    table = {**SINGLES, **VALUES, **FORMS}
    every = list(product(table, range(3), GAINS, KINDS))
    for turn, at in enumerate(np.random.default_rng(seed).permutation(len(every))):
        name, size, kp, kind = every[at]
        yield name, {name.split("/")[0]: drawn(table[name], size, turn)}, size, kp, kind


def judged(paths: tuple[Path, Path], columns: str, about: Mapping[str, Any]) -> Outcome:
    """Read recordings as the diagnosis does, and compare what is read with the files."""
    question = Question(recordings=paths[:1], holdout=paths[1:], bench=None, model=None,
                        columns=ColumnMap.load(columns or None), without=(), estimate=(), as_wired=False)  # fmt: skip
    begun = time.process_time()
    try:
        case = read_repaired(question, silent)
        if about.get("mistake") and not case.wiring:  # what causes leave is judged after them
            found = search_causes(Search(case.problem, case.candidates, NAMES), case.held)
            case = reconsider_wiring(case, found, silent)
    except InputError as error:
        return Outcome(**about, cpu=time.process_time() - begun, note=f"refused: {error}")
    cpu, chosen = time.process_time() - begun, case.question.columns
    repaired = case.question is not question
    assert chosen is None or isinstance(chosen, ColumnMap)
    right = _same(read_table(paths[0]).columns, read_table(paths[0], chosen).columns)
    return Outcome(**about, cpu=cpu, repaired=repaired, right=right, suspected=bool(case.wiring), note=case.wiring)


def _same(files: Mapping[str, Any], read: Mapping[str, Any]) -> bool:
    inner = slice(200, 200 + 5000)
    for name in set(files) & set(read) - {"piston_velocity", "hydraulic_force_rate", "load_force_rate"}:
        off = read[name][inner] - files[name][inner]
        if float(np.sqrt(np.mean(np.square(off)))) > SAME * float(np.ptp(files[name])):
            return False
    return True


@command()
def main() -> None:
    """Judge right recordings and wrong ones, and print a table."""
    options = _report.parser("wiring", __doc__)
    options.add_argument("--cases", type=int, default=1000, help="wired right (default: 1000)")
    options.add_argument("--wrong", type=int, default=10, help="benches for each mistake (default: 10)")
    options.add_argument("--seed", type=int, default=1, help="of order, signs and noise (default: 1)")
    options.add_argument("--write", type=Path, metavar="FILE", help="keep what is done, and go on with it")
    jobs.add_arguments(options)
    chosen = options.parse_args()
    benches: dict[str, tuple[Any, ...]] = {}
    every = [*cases(chosen.seed)]
    for role, count, mistakes in (("right", chosen.cases, {"": ""}), ("wrong", chosen.wrong, MISTAKES)):
        for number, case in enumerate(every[:count]):
            benches[f"{role} {number} of seed {chosen.seed}"] = (*case, chosen.seed + 2 * number, mistakes)
    done = jobs.complete(bench, benches, **jobs.where(chosen), kept=chosen.write, label="wiring", unit="bench")
    found = [Outcome(**one) for outcomes in done.values() for one in outcomes]
    _report.finish({"outcomes": [asdict(one) for one in found]}, chosen.json)
    print(_table(found).text())


def bench(
    name: str, effects: Mapping[str, Any], size: int, kp: float, kind: str, seed: int, mistakes: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Record a bench twice and judge its recordings after each of these mistakes."""
    warnings.simplefilter("error", RuntimeWarning)
    about = {"effect": name, "size": ("small", "middle", "large")[size], "kp": kp, "reference": kind}
    with tempfile.TemporaryDirectory() as scratch:
        paths = (Path(scratch) / "fitted.csv", Path(scratch) / "held.csv")
        for at, path in enumerate(paths):
            record(effects, kp, KINDS[(KINDS.index(kind) + at) % len(KINDS)], path, seed + at)
        return [asdict(judged(paths, columns, {**about, "mistake": one})) for one, columns in mistakes.items()]


def _table(found: list[Outcome]) -> Table:
    table = Table({
        "wired": "", "cases": "", "repaired": "recordings for which a repair was preferred",
        "right": "readings that are those of the right recording", "suspected": "cases with a note on wiring",
        "refused": "cases that could not be read", "cpu": "s of CPU, median; the largest",
    })  # fmt: skip
    for mistake in dict.fromkeys(one.mistake for one in found):
        own = [one for one in found if one.mistake == mistake]
        cpu = [one.cpu for one in own]
        table.add(
            wired=mistake or "right", cases=len(own), repaired=sum(one.repaired for one in own),
            right=sum(one.right for one in own), suspected=sum(one.suspected for one in own),
            refused=sum(one.note.startswith("refused") for one in own),
            cpu=f"{np.median(cpu):.1f}; {max(cpu):.1f}",
        )  # fmt: skip
    return table


if __name__ == "__main__":
    main()
