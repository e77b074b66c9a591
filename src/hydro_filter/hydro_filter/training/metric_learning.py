# SPDX-License-Identifier: Apache-2.0
"""Metric learning: roll out, label, solve a metric for each gain, evaluate by the empirical certificate.

**Refinement.** The solution P of Lyapunov's equation for one state has to decay at some hundred states of the rollouts,
a linear matrix inequality in P: descent on P = L_0 (I + X) (I + X)' L_0' from the equation's L_0 L_0', X lower
triangular, on the mean and the largest violation.

**Empirical certificate**, on held-out windows; no proof over a set of states (filter.md)::

    ((F + G K)' M (F + G K) - exp(-2 lambda T) M) / T        its largest eigenvalue relative to M; 0 or less: M decays

For gains of the certified range K is the force law's. All others are not to be certified, and K is that of the best
correction, so every sample is evaluated twice: in the metric for its own gain if that is in the range, and in that for
all other gains. Eigenvalues are of C^-1 ... C^-T with M = C C', so that they do not depend on the size of M.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydro_core.cli.console import Table, progress
from hydro_core.settings import check
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.controller.loop_filter import LoopFilterSettings
from hydro_filter.metric import (
    MetricDesign,
    ScheduledMetric,
    Thresholds,
    cholesky_entries,
    limit_to_stable_range,
    linearize_at_rest,
    require_stable_gain,
    solve_riccati,
)
from hydro_filter.model.coordinates import Q_LOAD, Q_SPOOL_RATE
from hydro_filter.model.loop import Loop, make_loop, without_overlap
from hydro_filter.training.data import (
    NEITHER,
    STABLE,
    UNSTABLE,
    DataSettings,
    Rollout,
    Windows,
    certified_range,
    draw_windows,
    measure_integral_allowance,
    noise_levels,
    roll_out,
)
from hydro_sim.box.box import BoxConfig
from hydro_sim.files import learned_bench, recordings
from hydro_sim.files.pairing import BoxIdentity, Provenance
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors

COLUMNS = {
    "metric": "still: equations of the still bench; solved: made to hold on samples",
    "gains": "certified: under the force law's own K_p of the range; foreign: under the best correction",
    "samples": "held-out samples",
    "violated": "%, samples in which some direction does not decay at lambda",
    "q50": "1/s, quantiles of the contraction matrix's largest eigenvalue relative to M; 0 or less holds",
    "q99": "",
    "q999": "",
    "largest": "",
    "condition": "median condition number of M",
    "condition_max": "largest",
}


CONTRACTION_RATE, FOREIGN_RATE = LoopFilterSettings().contraction_rate, LoopFilterSettings().foreign_rate
"""lambda [1/s] of the certified range, and of all other gains."""
RATE_MARGIN = 0.3
"""1/s, margin on both rates where metrics are solved, for states between the samples and for errors of the model."""


class RiccatiCorrection(NamedTuple):
    """Optimal linear correction about the bench at rest."""

    feedback: FloatArray
    """K [A], shape (c,)."""
    input_index: int
    """Index of the coordinate through which the current enters: its entry of G is proportional to g."""
    input_gain: float
    """Entry of G [1/A] at `input_index` for the bench at rest."""

    @classmethod
    def from_design(cls, loop: Loop, design: MetricDesign) -> RiccatiCorrection:
        """Solve the correction for the loop at rest; the current enters by the spool's rate, or the newest current."""
        on_their_way, input_vector = loop["on_their_way"], linearize_at_rest(loop, design.gain_low)[1]
        input_index = len(loop.scale) - on_their_way if on_their_way else Q_SPOOL_RATE
        return cls(solve_riccati(loop, design)[1], input_index, float(input_vector[input_index]))

    def feedback_at(self, input_vector: FloatArray) -> FloatArray:
        """Return K [A] at samples with these G, shape (..., c), scaled by g as the force law is."""
        return (self.input_gain / input_vector[..., self.input_index])[..., np.newaxis] * self.feedback


def close_loop(transition: FloatArray, input_vector: FloatArray, feedback: FloatArray) -> FloatArray:
    """Return F + G K, shape (..., c, c)."""
    return transition + input_vector[..., np.newaxis] * feedback[..., np.newaxis, :]


def certified_loops(windows: Windows, metric: ScheduledMetric) -> tuple[FloatArray, FloatArray]:
    """Return K_p, shape (n,), and F + G K, shape (n, H, c, c), of stable windows with certified gains."""
    inside = (windows.gain >= metric.gains[0]) & (windows.gain <= metric.gains[-1])
    wanted = windows.subset(inside & (windows.label == STABLE))
    return wanted.gain, close_loop(wanted.transition, wanted.input_vector, wanted.feedback)


def certificate_table(metrics: dict[str, ScheduledMetric], held_out: Windows, correction: RiccatiCorrection) -> Table:
    """Return the table of held-out violations, a row for each metric and kind of gains."""
    table = Table(COLUMNS, title=f"Contraction at lambda = {CONTRACTION_RATE:g} and {FOREIGN_RATE:g} 1/s, held out")
    corrected = close_loop(held_out.transition, held_out.input_vector, correction.feedback_at(held_out.input_vector))
    for name, metric in metrics.items():
        for kind, (gain, closed), rate in (
            ("certified", certified_loops(held_out, metric), CONTRACTION_RATE),
            ("foreign", (np.full(len(held_out), np.inf), corrected), FOREIGN_RATE),
        ):
            grown, condition = contraction_eigenvalues(metric, gain, closed, rate)
            q50, q99, q999, largest = (float(value) for value in np.quantile(grown, (0.5, 0.99, 0.999, 1.0)))
            table.add(
                metric=name, gains=kind, samples=len(grown),
                violated=100.0 * float((grown > 0.0).mean()), q50=q50, q99=q99, q999=q999, largest=largest,
                condition=float(np.median(condition)), condition_max=float(condition.max()),
            )  # fmt: skip
    return table


def contraction_eigenvalues(
    metric: ScheduledMetric, gain: FloatArray, closed: FloatArray, rate: float
) -> tuple[FloatArray, FloatArray]:
    """Return the largest eigenvalue [1/s] of the contraction matrix relative to M, and cond(M), shape (n H,) each.

    `gain`: K_p [1/s], shape (n,); infinite: the metric for all other gains. `closed`: F + G K, shape (n, H, c, c).
    """
    gains, which = np.unique(np.repeat(gain, closed.shape[1]), return_inverse=True)
    matrices, closed = np.array([metric.matrix(one) for one in gains]), closed.reshape(-1, *closed.shape[2:])
    moved, matrix = closed.transpose(0, 2, 1), matrices[which]
    factor = np.linalg.cholesky(matrix)
    half = np.linalg.solve(factor, moved @ matrix @ closed)
    whole = np.linalg.solve(factor, half.transpose(0, 2, 1))
    largest = np.linalg.eigvalsh(0.5 * (whole + whole.transpose(0, 2, 1)))[:, -1]
    return (largest - np.exp(-2.0 * rate * SAMPLE_PERIOD)) / SAMPLE_PERIOD, np.linalg.cond(matrices)[which]


DESCENT_SAMPLES = 120
DESCENT_STEPS = 250


def refine(metric: ScheduledMetric, windows: Windows, correction: RiccatiCorrection, seed: int) -> ScheduledMetric:
    """Return the metric with its factors refined so that the loop contracts at the required rate on drawn windows.

    Each factor is for one gain of the force law; the last is for all other gains, under the Riccati correction.
    """
    rng, stable = np.random.default_rng(seed), windows.subset(windows.label == STABLE)
    chosen = rng.choice(len(stable), min(DESCENT_SAMPLES, len(stable)), replace=False)
    transition, input_vector = stable.transition[chosen, 0], stable.input_vector[chosen, 0]
    problems = []
    for row, gain in zip(metric.table[:-1], metric.gains, strict=True):
        feedback = stable.feedback[chosen, 0].copy()
        feedback[:, Q_LOAD] *= gain / stable.gain[chosen]
        problems.append((row, close_loop(transition, input_vector, feedback), CONTRACTION_RATE + RATE_MARGIN))
    chosen = rng.choice(len(windows), min(DESCENT_SAMPLES, len(windows)), replace=False)
    transition, input_vector = windows.transition[chosen, 0], windows.input_vector[chosen, 0]
    foreign = close_loop(transition, input_vector, correction.feedback_at(input_vector))
    problems.append((metric.table[-1], foreign, FOREIGN_RATE + RATE_MARGIN))
    told = progress(problems, total=len(problems), label="solving", unit="metric", every=10.0)
    return replace(metric, table=np.array([refine_factor(*one) for one in told]))


def refine_factor(entries: FloatArray, closed: FloatArray, rate: float) -> FloatArray:
    """Return the entries of a metric's Cholesky factor after gradient descent on violations of the contraction rate.

    The metric is M = L L', scaled to M[Q_LOAD, Q_LOAD] = 1; `entries` are those of the initial L, shape (c (c + 1)/2,).
    The loss measures violations of the rate `rate` [1/s] by the closed loops F + G K, `closed`, shape (n, c, c).

    Adam (Kingma & Ba 2015) on X of L = L_0 (I + X). With H = L^-1 (F + G K)' L the growth is g, the largest eigenvalue
    of H H', at its unit eigenvector u; v = H'u. As dH = H E - E H for E = L^-1 dL, dg = 2 tr((v v' - g u u') E').
    """
    width = closed.shape[-1]
    start: FloatArray = np.zeros((width, width))
    eye: FloatArray = np.eye(width)
    start[np.tril_indices(width)] = entries
    # of largest growth are samples in which the spool passes zero, where law and valve have the g of either side
    limit, kept = float(np.exp(-2.0 * rate * SAMPLE_PERIOD)), len(closed) - int(0.02 * len(closed))
    moved, change, mean, square = closed.transpose(0, 2, 1), 0.0 * eye, 0.0 * eye, 0.0 * eye
    best, found = np.inf, start
    for step in range(DESCENT_STEPS):
        factor = start @ (eye + change)
        half = np.linalg.inv(factor) @ moved @ factor
        grown, vectors = np.linalg.eigh(half @ half.transpose(0, 2, 1))
        asked = np.argsort(grown[:, -1])[:kept]
        excess = np.maximum(grown[asked, -1] - limit, 0.0) / SAMPLE_PERIOD
        value = excess.mean() + 0.3 * excess[-1] + 1e-3 * (change**2).sum()
        if value < best:
            best, found = value, factor
        if best == 0.0:
            break
        weights = (excess > 0.0) / kept
        weights[-1] += 0.3 * (excess[-1] > 0.0)
        u = vectors[asked, :, -1]
        v = (u[:, None, :] @ half[asked])[:, 0]
        slope = (v.T * weights) @ v - (u.T * (weights * grown[asked, -1])) @ u
        slope = np.tril(np.linalg.inv(eye + change).T @ slope) * (2.0 / SAMPLE_PERIOD) + 2e-3 * change
        mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
        pace = (2e-2 * (1.0 - step / DESCENT_STEPS) + 1e-4) / (1.0 - 0.9 ** (step + 1))
        change = change - pace * mean / (np.sqrt(square / (1.0 - 0.999 ** (step + 1))) + 1e-8)
    weight = found @ found.T
    return cholesky_entries(weight / weight[Q_LOAD, Q_LOAD])


HELD_OUT_INTERVAL = 5
"""Interval of the held-out rollouts: every fifth."""


def learn_metric(options: argparse.Namespace) -> None:
    """Learn the metric specified by the command line and write its file."""
    data = DataSettings(rollouts=options.rollouts, seed=options.seed)
    check(data)
    out, began = Path(options.out), time.monotonic()
    model = learned_bench.load_model(options.model)
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    remedy = "name the bench.yaml of its box by --bench, or learn a model from this box's recordings (hydro_sim learn)"
    box = BoxIdentity.of_file(options.bench)
    learned_bench.require_match(options.model, box, remedy)
    if options.recording:
        recordings.require_same_box(options.recording, box)
    provenance = Provenance(box=bench.digest, model=model.digest)  # either form of the integral: decision 31
    loop = make_loop(model, bench)
    if without_overlap(model) is not None:
        _say("the bench file has a valve_deadband: corrections leap over it by both half widths, or reduce the overlap")
    laws = [data] if options.law != "compensated" else []
    if options.law != "paper":
        laws += _compensated(options, bench, data)
    found: list[tuple[ScheduledMetric, Table]] = []
    missing: list[str] = []
    for law in laws:
        try:
            found.append(_certify(model, bench, loop, law, options))
        except ValueError as error:
            if len(laws) == 1:
                raise
            missing.append(f"{law.law.name.lower()} law: {error}")
    if not found:
        raise ValueError(f"no force law has a certificate on this bench: {'; '.join(missing)}")
    table = found[0][1]
    for _, more in found[1:]:
        table.rows += more.rows
    sound = [metric for metric, _ in found if not metric.validity_error(out.name)] or [found[0][0]]
    final = replace(sound[0], another=sound[1] if len(sound) > 1 else None)
    final = replace(
        final, provenance=provenance, training={**final.training, "seconds": round(time.monotonic() - began, 1)}
    )
    final.save(out)
    table.show(options.json)
    for one in final.all_metrics:
        sizes = one.thresholds.noise_size, one.thresholds.foreign_noise_size
        noise = f"noise is v'Mv up to {sizes[0]:.2g} and {sizes[1]:.2g}"
        print(f"{out}: C_1 = {one.velocity_compensation:g}, {noise}")
    for metric, _ in found:
        if reason := metric.validity_error(out.name):
            kept = "left out of the file" if metric is not sound[0] else "the filter refuses it"
            missing.append(f"C_1 = {metric.velocity_compensation:g}: {reason}; {kept}")
    for sentence in missing:
        _say(sentence)


def _compensated(options: argparse.Namespace, bench: Bench, data: DataSettings) -> list[DataSettings]:
    """Return rollouts under the compensated law of the recorded box, or of a box of this bench; none if it has none."""
    law = recordings.box_law(options.recording) if options.recording else BoxConfig().of_bench(bench).compensated
    if law is not None:
        return [DataSettings.for_law(law, rollouts=data.rollouts // 2, seed=data.seed)]
    if options.law == "compensated":
        raise ValueError(f"the box of {options.recording} offers no compensated law: leave out --law compensated")
    _say(f"the box of {options.recording} offers no compensated law: a metric of the paper's alone")
    return []


def _certify(
    model: Bench, bench: Bench, loop: Loop, data: DataSettings, options: argparse.Namespace
) -> tuple[ScheduledMetric, Table]:
    """Return the metric for the law of `data`, and its certificate's table; raises ValueError if there is none."""
    c_1, law = data.velocity_compensation, data.compensated
    at_c_1 = "" if c_1 == 1.0 else f"C_1 = {c_1:g}"
    require_stable_gain(loop, c_1)
    plant, clean = (learned_bench.make_plant(options.model, noise=noise) for noise in (1.0, 0.0))
    training, held_out, rollouts = collect_rollouts(plant, bench, loop, data, plant_without_overlap(model))
    design = _design(loop, data, rollouts)
    require_held_out(held_out, design)
    counts = Counter(rollout.label for rollout in rollouts)
    _say(
        f"{counts[STABLE]} rollouts are stable, {counts[UNSTABLE]} unstable, {counts[NEITHER]} neither; certified "
        f"range: K_p {design.gain_low:g} to {design.gain_high:g} 1/s" + (f" at {at_c_1}" if at_c_1 else "")
    )
    if law is not None and law.base_kp > design.gain_high:
        _say(f"the box's base K_p of {law.base_kp:.0f} 1/s is above that range: a lower one needs fewer corrections")
    correction, still = RiccatiCorrection.from_design(loop, design), ScheduledMetric.from_design(loop, design)
    metric = refine(still, training, correction, options.seed)
    noise, foreign_noise = noise_levels(metric, loop, plant, clean)
    thresholds = Thresholds(
        noise_size=noise,
        foreign_noise_size=foreign_noise,
        integral_allowance=measure_integral_allowance(loop, plant, bench, data),
    )
    of = f", {at_c_1}" if at_c_1 else ""
    table = certificate_table({f"still{of}": still, f"solved{of}": metric}, held_out, correction)
    violated, foreign = (row["violated"] for row in table.rows[-2:])
    facts = {
        "command": " ".join(["learn_metric", *sys.argv[1:]]), "data": asdict(data),
        "rates": {"rate": CONTRACTION_RATE, "foreign_rate": FOREIGN_RATE, "margin": RATE_MARGIN},
        "design": asdict(design), "model": model.digest, "violated": violated, "foreign_violated": foreign,
    }  # fmt: skip
    return replace(metric, thresholds=thresholds, training=facts), table


def _design(loop: Loop, data: DataSettings, rollouts: list[Rollout]) -> MetricDesign:
    """Return the design for the gains of stable rollouts that the law admits."""
    law, design = data.compensated, MetricDesign(velocity_compensation=data.velocity_compensation)
    # at C_1 below 1 rollouts at small gains are slow, not unstable: a smaller reserve above them
    low, high = certified_range(rollouts) if law is None else certified_range(rollouts, 0.005 * law.base_kp)
    low, high = round(low), round(high)
    if law is not None:
        low = max(low, math.floor(law.base_kp + law.delta_kp_min), 1)
        high = min(high, math.ceil(law.base_kp + law.delta_kp_max))
    return limit_to_stable_range(loop, replace(design, gain_low=low, gain_high=high))


def plant_without_overlap(model: Bench) -> AnalyticPlant | None:
    """Return the plant of a bench file without its valve's overlap; None if it has none."""
    free = without_overlap(model)
    return None if free is None else AnalyticPlant(free, settings=Sensors.of_size(free.size))


def require_held_out(held_out: Windows, design: MetricDesign) -> None:
    """Raise ValueError if no stable held-out window has a gain of the certified range."""
    inside = (held_out.gain >= design.gain_low) & (held_out.gain <= design.gain_high)
    if not (inside & (held_out.label == STABLE)).any():
        certified = f"K_p {design.gain_low:g} to {design.gain_high:g} 1/s"
        raise ValueError(f"no held-out rollout has a gain of the certified range, {certified}: give more --rollouts")


def collect_rollouts(
    plant: AnalyticPlant, bench: Bench, loop: Loop, data: DataSettings, overlap_free: AnalyticPlant | None = None
) -> tuple[Windows, Windows, list[Rollout]]:
    """Return training windows, held-out windows (every fifth rollout), and all rollouts.

    `overlap_free`: as in `roll_out`.
    """
    kept: list[Windows] = []
    held_out: list[Windows] = []
    rollouts: list[Rollout] = []
    for index in progress(range(data.rollouts), label="rollouts", unit="run", every=10.0):
        rollouts.append(rollout := roll_out(plant, bench, data, index, overlap_free))
        windows = draw_windows(rollout, loop, data, index)
        if windows is not None and rollout.label != NEITHER:
            (held_out if index % HELD_OUT_INTERVAL == HELD_OUT_INTERVAL - 1 else kept).append(windows)
    return Windows.concatenate(kept), Windows.concatenate(held_out), rollouts


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr)
