# SPDX-License-Identifier: Apache-2.0
"""The filter made for a bench that is not the shipped one, on the emulated bench; the box keeps to the nominal file.

file         a bench file that says the change and what a diagnosis finds, its metric by `learn_metric`:
             without a filter and behind it at wide gains, sample by sample
compensated  the compensated law at its own gains, through guard and estimator, on the default truth and on drawn ones:
             without a filter, with that of a bench file with the truth's own parameters (--diagnosed: of what a
             diagnosis of two recordings finds), and with the shipped one, which answers BYPASSED; `mismatch` of the
             latter is what its watch says of the same samples
drawn_gains  the same benches, gains drawn 100 times a second at the law's own C_1 and at C_1 = 1, without a filter and
             with that of the bench file, whose metrics are for either
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._drawn_truths import drawn_truths
from benchmarks._report import parser
from benchmarks.compensated_law import diagnosed
from benchmarks.controllers import SETTINGS
from benchmarks.controllers import table as law_table
from benchmarks.model_mismatch import outcome, play
from hydro_bridge.cli.console import Table, command, progress
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, CorrectionStatus, Flag, Law, ReferenceSignal, Waveform
from hydro_filter.controller.factory import FilterChoice, warm_up
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, Result, default_filter
from hydro_filter.model.sample import Sample
from hydro_filter.precompile import FOUND
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.task.cases import Case
from hydro_sim.box.box import BoxConfig, law_state
from hydro_sim.emulator.truth.config import TruthConfig, profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from tests.changing_plant import modified_truth
from tests.offline_graph import OfflineGraph

CELL = {"sensor": "load_force", "bandwidth": 25.0, "damping": 0.55}
"""The truth's load cell, which a list of lags takes the place of."""
BENCHES: dict[str, tuple[Mapping[str, Any], Mapping[str, float]]] = {
    "as learned": ({}, {}),
    **{f"spring {k:g} kN/m": ({}, {"spring_stiffness": 1e3 * k}) for k in (10.0, 30.0, 50.0)},
    **{f"supply {p:g} MPa": ({}, {"supply_pressure": 1e6 * p}) for p in (10.0, 13.0)},
    "valve gain -25 %": ({"valve_gain": {"ratio": 0.75}}, {}),
    **{f"dead time {1e3 * t:g} ms": ({"transport_delay": {"time": t}}, {}) for t in (1e-3, 2e-3)},
    **{
        f"pressure sensors {f:g} Hz": (
            {"sensor_lag": [{"sensor": f"pressure_{one}", "bandwidth": f, "damping": 0.7} for one in "ab"]}, {}
        )
        for f in (200.0, 80.0)
    },
    "deadband 0.5 mA": ({"valve_deadband": {"half_width": 5e-4}}, {}),
}  # fmt: skip
"""Of each bench: effects and numbers that differ."""
FORMS: dict[str, tuple[str, ...]] = {
    "spring_stiffness": ("ratio",), "supply_pressure": ("ratio",), "valve_gain": ("ratio",),
    "valve_gain_asymmetry": ("ratio",), "leakage_internal": ("coefficient",), "friction_coulomb": ("force",),
    "friction_stribeck": ("breakaway_force", "velocity"), "friction_presliding": ("stiffness",),
    "valve_lag": ("bandwidth", "damping"), "moving_mass": ("mass",), "valve_deadband": ("half_width",),
    "entrained_air": ("volume_fraction",),
}  # fmt: skip
"""Effects of the truths, with the parameters that the model's own forms have."""
DRAWN_GAINS = ((15.0, 5.0), (300.0, 30.0))
"""Least and greatest K_p [1/s], K_i [1/s^2]."""
CASES = SETTINGS.cases[:4]
REFERENCE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
BEGIN, SECONDS = 2000, 6.0
"""Samples that are not judged; s of a run."""
ACTING = (int(CorrectionStatus.MODIFIED), int(CorrectionStatus.RELAXED))
COLUMNS = {
    "bench": "",
    "gains": "asked for: K_p, K_i",
    "filter": "none, or made for the bench",
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
    "made_in": "s, for the filter",
}
Made = tuple[LoopFilter, dict[str, Any]]
"""A filter, and what is said of its metric."""


class Timed:
    """A filter that notes how long it takes. See `Corrector`."""

    def __init__(self, timed: LoopFilter) -> None:
        self.filter, self.reset = timed, timed.reset
        self.took: list[float] = []

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """See `Corrector`."""
        began = time.perf_counter()
        result = self.filter.correct(sample, age)
        self.took.append(time.perf_counter() - began)
        return result


def truth_of(name: str) -> dict[str, Any]:
    """The change of the emulator's default truth."""
    effects, numbers = BENCHES[name]
    lags = {"sensor_lag": [CELL, *effects["sensor_lag"]]} if "sensor_lag" in effects else {}
    return {"effects": {**effects, **lags}, "bench": dict(numbers)}


def by_file(name: str, folder: Path) -> Made:
    """The filter on a bench file of the change and what a diagnosis finds."""
    effects: list[Any] = list(FOUND)
    for effect, values in BENCHES[name][0].items():
        for one in values if isinstance(values, list) else [values]:
            options = {key: value for key, value in one.items() if isinstance(value, str)}
            effects.append({"id": effect, **options, "parameters": {k: v for k, v in one.items() if k not in options}})
    return by_metric(folder / "bench.yaml", BENCHES[name][1], effects, "paper")


def by_truth(config: TruthConfig, folder: Path, law: str = "compensated") -> Made:
    """The filter for the compensated law or both on a bench file with a truth's own parameters."""
    found = {name: getattr(config.effects, name) for name in FORMS}
    effects: list[Any] = [
        {"id": name, "parameters": {each: getattr(effect, each) for each in FORMS[name]}}
        for name, effect in found.items() if effect is not None
    ]  # fmt: skip
    effects += [
        {"id": "sensor_lag", "sensor": lag.sensor, "parameters": {"bandwidth": lag.bandwidth, "damping": lag.damping}}
        for lag in config.effects.sensor_lag
    ]
    return by_metric(folder / "bench.yaml", {}, effects, law)


def by_diagnosis(config: TruthConfig, folder: Path, law: str) -> Made:
    """The same on the file of a diagnosis."""
    model = folder / "corrected.yaml"
    return metric_for(model if model.exists() else diagnosed(config, folder), law)


def by_metric(model: Path, numbers: Mapping[str, float], effects: Sequence[Any], law: str) -> Made:
    """The filter on a bench file that is written there."""
    content = Bench.nominal().to_mapping() | dict(numbers) | {"effects": [dict(one) for one in effects]}
    model.write_text(yaml.safe_dump(content), encoding="utf-8")
    return metric_for(model, law)


def metric_for(model: Path, law: str) -> Made:
    """The filter on this bench file; a metric beside it is taken."""
    out, table, began, said = (
        model.with_name("metric.safetensors"),
        model.with_name("metric.json"),
        time.monotonic(),
        "",
    )
    words = ["--out", str(out), "--model", str(model), "--law", law, "--json", str(table)]
    if not out.exists():
        said = run("hydro_filter.training.learn_metric", *words)
    return loaded(out, model), told(table, said, began)


def run(module: str, *words: str) -> str:
    """What a command of ours says on stderr (raises ValueError with its own words)."""
    start = f"import sys; from hydro_bridge.process.start import main_of; sys.exit(main_of.{module}())"
    done = subprocess.run([sys.executable, "-c", start, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1].removeprefix("error: "))
    return done.stderr


def told(table: Path, said: str, began: float) -> dict[str, Any]:
    """What is said of a metric that was begun then."""
    rows = yaml.safe_load(table.read_text(encoding="utf-8"))["rows"]
    solved = next(row for row in rows if row["metric"].startswith("solved") and row["gains"] == "certified")
    span = said.partition("certified range: K_p ")[2].partition(" 1/s")[0]  # the paper's law comes first
    return {"range": span, "violated": solved["violated"], "made_in": time.monotonic() - began}


def loaded(metric: Path, model: Path) -> LoopFilter:
    """The filter of these files, compiled and ready (raises ValueError where they do not belong together)."""
    choice = FilterChoice(bench=Bench.nominal(), metric=str(metric), model=model)
    if trouble := choice.trouble():
        raise ValueError(trouble)
    made = choice.make(LoopFilterSettings())
    warm_up(made, choice.bench)
    return made


def wide_gains(name: str, made: Made | None) -> Iterator[dict[str, Any]]:
    """Rows of a bench: without a filter, and under wide gains behind this one, if there is one."""
    plant = TruthPlant(modified_truth(truth_of(name)))
    for gains in ((90.0, 15.0), (250.0, 15.0), (300.0, 30.0)):
        for timed in (None, *([Timed(made[0])] if made is not None and gains[0] > 90.0 else [])):
            own = FixedGains(*gains)
            states, statuses = play(plant, own, REFERENCE, timed, SECONDS)
            done, settled = outcome(states, np.zeros(0), BEGIN), statuses[BEGIN:]
            row = {"bench": name, "gains": f"{gains[0]:g}, {gains[1]:g}", "filter": "none" if timed is None else "own"}
            row |= {key: getattr(done, key) for key in ("rmse", "peak", "jump", "tripped")} | shares(settled)
            row |= dict.fromkeys(list(COLUMNS)[9:], np.nan)
            if timed is not None and made is not None:
                row |= dict(zip(("call_p50", "call_p99"), 1e6 * np.quantile(timed.took, (0.5, 0.99)), strict=True))
                row |= made[1]
            yield row


def shares(statuses: Any) -> dict[str, float]:
    """Of samples told as another bench's, and of corrected ones [%]."""
    which = {"mismatch": statuses == CorrectionStatus.MISMATCH, "corrected": np.isin(statuses, ACTING)}
    return {key: 100.0 * float(np.mean(one)) if len(one) else np.nan for key, one in which.items()}


def under_the_law(
    config: TruthConfig, case: Case, corrector: LoopFilter | None, law: BoxLaw, *, drawn: bool = False
) -> Iterator[tuple[np.void, int]]:
    """Samples of a run at the law's own gains or drawn ones, each with its status, until the box trips."""
    graph = OfflineGraph(TruthPlant(config), Bench.nominal(), config=BoxConfig(compensated=law), corrector=corrector)
    live, rng, base = LiveCompensation(law), np.random.default_rng(0), np.array((law.base_kp, law.base_ki))
    if corrector is not None:
        corrector.reset()
    graph.reference(case.signal)
    for k in range(round(SECONDS / SAMPLE_PERIOD)):
        if k % SAMPLES_PER_STEP == 0:
            graph.command_law(live.command, k)
            graph.gains(*(rng.uniform(*DRAWN_GAINS) - base if drawn else (0.0, 0.0)), k)
        graph.arm(k > 0)
        sample, acts = graph.sample().copy(), law_state(graph.box.state[0])
        sequence, mismatched = int(sample["sequence"]), graph.answer.status is CorrectionStatus.MISMATCH
        if acts.law is Law.COMPENSATED:
            live.on_law_state(sequence, acts.law, acts.compensated_reference)
        live.on_sample(sequence, float(sample["load_force"]), int(sample["flags"]), holds=mismatched)
        yield sample, int(graph.answer.status)
        if int(sample["flags"]) & Flag.TRIPPED:
            return


def law_rows(config: TruthConfig, own: LoopFilter, shipped: LoopFilter) -> Iterator[dict[str, Any]]:
    """Three rows of each reference: without a filter, with its own, and with the shipped one."""
    for case in CASES:
        plain = list(under_the_law(config, case, None, BoxLaw()))
        yield {"filter": "none", "reference": case.name, **figures(plain)}
        yield {"filter": "own", "reference": case.name, **figures(list(under_the_law(config, case, own, BoxLaw())))}
        shipped.reset()
        watched = [(sample, int(shipped.correct(Sample.of(sample)).status)) for sample, _ in plain]
        yield {"filter": "shipped", "reference": case.name, **figures(watched), "corrected": 0.0}


def drawn_rows(config: TruthConfig, own: LoopFilter) -> Iterator[dict[str, Any]]:
    """Rows of each reference at drawn gains: C_1 of the law and 1, without a filter and with its own."""
    for law in (BoxLaw(), BoxLaw(velocity_compensation=1.0, velocity_compensation_max=1.0)):
        for name, corrector in (("none", None), ("own", own)):
            label = f"{name}, C_1 = {law.velocity_compensation:g}"
            for case in CASES:
                run = list(under_the_law(config, case, corrector, law, drawn=True))
                yield {"filter": label, "reference": case.name, **figures(run)}


def figures(done: Sequence[tuple[np.void, int]]) -> dict[str, Any]:
    """Error after 2 s [N], a sine's own where it tripped, RMS of u' [A/s], and shares of samples [%]."""
    states = np.array([sample for sample, _ in done])
    settled, statuses = states[BEGIN:], np.array([status for _, status in done[BEGIN:]])
    error = settled["reference_force"] - settled["load_force"]
    rms = {"rmse": error, "current_rate_rms": np.diff(settled["valve_current"]) / SAMPLE_PERIOD}
    squares = {key: float(np.sqrt(np.mean(each**2))) if len(each) else np.nan for key, each in rms.items()}
    tripped = bool(int(states["flags"][-1]) & Flag.TRIPPED)
    if tripped:
        squares["rmse"] = SETTINGS.amplitude / np.sqrt(2.0)
    return {**squares, "tripped": tripped, **shares(statuses)}


@command(ValueError, OSError)
def main() -> None:
    """Measure, print, write."""
    options = parser("bench_file_filter", __doc__)
    options.add_argument("what", nargs="?", default="file", choices=("file", "compensated", "drawn_gains"))
    options.add_argument("--bench", nargs="+", default=list(BENCHES), choices=list(BENCHES), help="default: all")
    options.add_argument("--draw", type=int, default=12, metavar="COUNT", help="drawn truths; default: %(default)s")
    options.add_argument("--diagnosed", action="store_true", help="a diagnosis of the truth in place of its parameters")
    options.add_argument("--folder", type=Path, default=Path("runs/bench_file_filter"), help="default: %(default)s")
    asked = options.parse_args()
    truths: dict[str, TruthConfig] = dict.fromkeys(asked.bench)
    under_law = asked.what in ("compensated", "drawn_gains")
    if under_law:
        drawn = {f"drawn_{name}_1": truth_from_mapping(one) for name, one in drawn_truths(asked.draw, 1).items()}
        truths = {"default": profile("default"), **drawn}
    table, rows, shipped = Table(COLUMNS, title="The filter made for a bench"), list[dict[str, Any]](), default_filter()
    for name in progress(truths, total=len(truths), label="benches", unit="bench"):
        folder = (
            asked.folder
            / (asked.what + "_diagnosed" * asked.diagnosed)
            / name.translate(str.maketrans(" /", "__", "%"))
        )
        folder.mkdir(parents=True, exist_ok=True)
        try:
            if under_law:
                laws, kind = "compensated" if asked.what == "compensated" else "both", name.partition("_")[0]
                own = (by_diagnosis if asked.diagnosed else by_truth)(truths[name], folder, laws)[0]
                runs = drawn_rows(truths[name], own) if laws == "both" else law_rows(truths[name], own, shipped)
                rows += [{"bench": kind, **row} for row in runs]
                continue
            made = by_file(name, folder)
        except ValueError as error:
            print(f"{name}: {error}", file=sys.stderr)
            made = None
        for row in wide_gains(name, made) if not under_law else ():
            table.add(**row)
    (law_table(rows, CASES, ("bench", "filter"), ("mismatch", "corrected")) if rows else table).show(asked.json)


if __name__ == "__main__":
    main()
