# SPDX-License-Identifier: Apache-2.0
"""Metric learning: roll out, label, solve a metric for each gain, evaluate."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from hydro_bridge.cli.console import Table, progress
from hydro_bridge.settings import check
from hydro_bridge.signals import Law
from hydro_filter.metric.design import MetricDesign, correcting_feedback, decaying_range, require_decay, rest_loop
from hydro_filter.metric.scheduled import ScheduledMetric, Thresholds
from hydro_filter.model.loop import driven_coordinate, loop_of, without_overlap
from hydro_filter.model.parts import Loop
from hydro_filter.training.certificate import (
    Correction,
    DecayRates,
    Samples,
    certificate_table,
    certified_samples,
    foreign_samples,
    where_violated,
)
from hydro_filter.training.data import (
    NEITHER,
    STABLE,
    UNSTABLE,
    DataSettings,
    Rollout,
    Windows,
    certified_range,
    collect,
    concatenated,
)
from hydro_filter.training.lmi_refinement import refined_rows
from hydro_filter.training.thresholds import integral_allowance, noise_sizes
from hydro_sim.box.box import BoxConfig
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity, MadeFor
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors

HELD_OUT = 5
"""Every fifth rollout is held out."""
SLOW_RESERVE = 2.0
"""1/s above the highest small K_p whose rollouts do not decay: with C_1 below 1 these are slow, not unstable."""
OVERLAP_TOLD = (
    "the bench file has a valve_deadband, within which no current moves the piston: the metric is of the loop without "
    "it, and corrections leap over it; reduce the overlap, or expect leaps of the current by both half widths"
)
"""Told of a bench with an overlap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingData:
    """Training data from the rollouts."""

    training: Windows
    held_out: Windows
    rollouts: list[Rollout]


def learn(options: argparse.Namespace) -> None:
    """Solve the metric specified by the command line, and write it."""
    data, rates = DataSettings(rollouts=options.rollouts, seed=options.seed), DecayRates(rate=options.contraction_rate)
    for each in (data, rates):
        check(each)
    torch.set_num_threads(options.threads or torch.get_num_threads())
    out, began = Path(options.out), time.monotonic()
    model = learned_bench.load_model(options.model)
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    remedy = "name the bench.yaml of its box by --bench, or learn a model from this box's recordings (hydro_sim learn)"
    learned_bench.require_match(options.model, BoxIdentity.of_file(options.bench), remedy)
    made = MadeFor(box=bench.digest, model=model.digest)  # either form of the integral: decision 31
    loop = loop_of(model, bench)
    if free_plant(model) is not None:
        _say(OVERLAP_TOLD)
    laws = [data] if options.law != "compensated" else []
    if options.law != "paper":
        laws.append(DataSettings.under(BoxConfig().compensated, rollouts=data.rollouts // 2, seed=data.seed))
    found: list[tuple[ScheduledMetric, Table]] = []
    for law in laws:
        try:
            found.append(_certificate(model, bench, loop, law, rates, options))
        except ValueError as error:
            if len(laws) == 1:
                raise
            _say(f"{law.law.name.lower()} law: {error}")
    if not found:
        raise ValueError("no force law has a certificate on this bench")
    table = found[0][1]
    for row in (row for _, more in found[1:] for row in more.rows):
        table.add(**row)
    sound = [metric for metric, _ in found if not metric.unfit(out.name)] or [found[0][0]]
    final = replace(sound[0], another=sound[1] if len(sound) > 1 else None)
    final = replace(final, made=made, training={**final.training, "seconds": round(time.monotonic() - began, 1)})
    final.save(out)
    table.show(options.json)
    for one in final.certificates:
        sizes = one.thresholds.noise_size, one.thresholds.foreign_noise_size
        told = f"noise is v'Mv up to {sizes[0]:.2g} and {sizes[1]:.2g}"
        print(f"{out}: C_1 = {one.velocity_compensation:g}, {told}")
    for metric, _ in found:
        if reason := metric.unfit(out.name):
            kept = "left out of the file" if metric is not sound[0] else "the filter refuses it"
            _say(f"C_1 = {metric.velocity_compensation:g}: {reason}; {kept}")


def _certificate(
    model: Bench, bench: Bench, loop: Loop, data: DataSettings, rates: DecayRates,
    options: argparse.Namespace,
) -> tuple[ScheduledMetric, Table]:  # fmt: skip
    """The metric for the law of `data`, and its certificate's table (raises ValueError where there is none)."""
    c_1 = data.velocity_compensation
    require_decay(loop, c_1)
    plant, clean = (learned_bench.make_plant(options.model, noise=noise) for noise in (1.0, 0.0))
    material = collect_rollouts(plant, bench, loop, data, free_plant(model))
    design = _design(loop, data, material.rollouts)
    require_held_out(material.held_out, design)
    told = f"certified range: K_p {design.gain_low:g} to {design.gain_high:g} 1/s"
    _say(f"{_told(material.rollouts)}; {told}" + ("" if c_1 == 1.0 else f" at C_1 = {c_1:g}"))
    best_correction = correction(loop, design)
    metric = _refined(ScheduledMetric.designed(loop, design), material.training, best_correction, rates, options.seed)

    def held_out(one: ScheduledMetric) -> tuple[Samples, Samples]:
        return certified_samples(material.held_out, one), foreign_samples(material.held_out, best_correction)

    sizes = noise_sizes(metric, loop, plant, clean)
    allowance = integral_allowance(loop, plant, bench, data)
    still, of = ScheduledMetric.designed(loop, design), "" if c_1 == 1.0 else f", C_1 = {c_1:g}"
    table = certificate_table({f"still{of}": still, f"solved{of}": metric}, held_out, rates)
    violated, foreign = (row["violated"] for row in table.rows[-2:])
    facts = {
        "command": " ".join(["learn_metric", *sys.argv[1:]]), "data": asdict(data), "rates": asdict(rates),
        "design": asdict(design), "model": model.digest, "violated": violated, "foreign_violated": foreign,
        "where": where_violated(metric, held_out(metric)[0], rates.rate),
    }  # fmt: skip
    levels = Thresholds(noise_size=sizes[0], foreign_noise_size=sizes[1], integral_allowance=allowance)
    return replace(metric, thresholds=levels, training=facts), table


def _design(loop: Loop, data: DataSettings, rollouts: list[Rollout]) -> MetricDesign:
    """The gains for which metrics are solved: those of stable rollouts, and of the compensated law those it admits."""
    if data.law is Law.PAPER:
        low, high = certified_range(rollouts)
        return decaying_range(loop, replace(MetricDesign(), gain_low=round(low), gain_high=round(high)))
    law = BoxConfig().compensated
    low, high = certified_range(rollouts, low_reserve=SLOW_RESERVE)
    low, high = max(round(low), law.base_kp + law.delta_kp_min), min(round(high), law.base_kp + law.delta_kp_max)
    usual = MetricDesign(velocity_compensation=data.velocity_compensation)
    return decaying_range(loop, replace(usual, gain_low=low, gain_high=high))


def free_plant(model: Bench) -> AnalyticPlant | None:
    """Return the plant of a bench file without its valve's overlap; None if it has none."""
    free = without_overlap(model)
    return None if free is None else AnalyticPlant(free, settings=Sensors.of_size(free.size))


def require_held_out(held_out: Windows, design: MetricDesign) -> None:
    """Raise ValueError if no held-out rollout can judge the certified range."""
    inside = (held_out.gain >= design.gain_low) & (held_out.gain <= design.gain_high)
    if not (inside & (held_out.label == STABLE)).any():
        raise ValueError(
            f"no held-out rollout has a gain of the certified range, K_p {design.gain_low:g} to {design.gain_high:g} "
            "1/s, so that nothing can judge a metric of it: give more --rollouts"
        )


def collect_rollouts(
    plant: AnalyticPlant, bench: Bench, loop: Loop, data: DataSettings, free: AnalyticPlant | None = None
) -> TrainingData:
    """Collect all rollouts, every fifth held out; `free`: see `roll_out`."""
    kept: list[Windows] = []
    held_out: list[Windows] = []
    rollouts: list[Rollout] = []
    bar = progress(
        collect(plant, bench, loop, data, free), total=data.rollouts, label="rollouts", unit="run", every=10.0
    )
    for index, (rollout, windows) in enumerate(bar):
        rollouts.append(rollout)
        if windows is not None and rollout.label != NEITHER:
            (held_out if index % HELD_OUT == HELD_OUT - 1 else kept).append(windows)
    return TrainingData(training=concatenated(kept), held_out=concatenated(held_out), rollouts=rollouts)


def correction(loop: Loop, design: MetricDesign) -> Correction:
    """The best correction about the still bench."""
    driven, push = driven_coordinate(loop), rest_loop(loop, design.gain_low)[1]
    return Correction(correcting_feedback(loop, design), driven, float(push[driven]))


def _refined(
    metric: ScheduledMetric, windows: Windows, best: Correction, rates: DecayRates, seed: int
) -> ScheduledMetric:
    """The table made to hold on samples of the rollouts."""
    foreign = foreign_samples(windows, best).closed.reshape(windows.transition.shape)
    asked = rates.rate + rates.margin, rates.foreign_rate + rates.margin
    rows = refined_rows(metric, windows, foreign, asked, seed)
    return replace(
        metric,
        table=np.array(list(progress(rows, total=len(metric.table), label="solving", unit="metric", every=10.0))),
    )


def _told(rollouts: list[Rollout]) -> str:
    counts = Counter(rollout.label for rollout in rollouts)
    return f"{counts[STABLE]} rollouts are stable, {counts[UNSTABLE]} unstable, {counts[NEITHER]} neither"


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr)
