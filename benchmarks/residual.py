# SPDX-License-Identifier: Apache-2.0
"""The learned residual on the compensated law: trained on drawn benches, scored on others.

    python -m benchmarks.residual --truths 40 --seed 4242 --json residual.json      scores the shipped one: 10 s a truth
    python -m benchmarks.residual --train residual.safetensors --seed 1              trains another: 15 minutes
    python -m benchmarks.residual --changes                                          the bench changes in mid-run

Each truth tracks each of nine references, none of them among those of the training, once under the compensated law
alone and once with the residual. What was run by this version is kept in the .rows beside the file of --json, and not
run again.

Training runs new benches and references under the network of the round before, and fits the corrections that turn out
to have been needed (dataset aggregation: Ross, Gordon, Bagnell 2011, AISTATS).

Interquartile means over all pairs, with 95 % bootstrap intervals over the truths; u' is the current's rate.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks._report import interquartile_mean, parser, results
from benchmarks._truths import drawn_truths, tracked, truth_fleet, yielding
from hydro_bridge.bags.writer import code_version
from hydro_core.cli.console import Table, command, progress
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.residual import CORRECTION_DELAY, INPUT_COUNT, OUTPUT_COUNT, STRUCTURE, Network, Residual
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import BASE_GAINS
from hydro_sim.box.firmware import reference_force
from hydro_sim.emulator.truth.config import TruthConfig, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.files import weights


def _signal(waveform: Waveform, amplitude: float, frequency: float, offset: float, phase: float) -> ReferenceSignal:
    return ReferenceSignal(waveform=waveform, amplitude=amplitude, frequency=frequency, offset=offset, phase=phase)


REFERENCES = {
    "0.35 Hz": _signal(Waveform.SINE, 220.0, 0.35, 0.0, 0.0),
    "0.7 Hz": _signal(Waveform.SINE, 260.0, 0.7, 0.0, 0.0),
    "1.3 Hz": _signal(Waveform.SINE, 180.0, 1.3, 0.0, 0.0),
    "1.8 Hz": _signal(Waveform.SINE, 280.0, 1.8, 0.0, 0.0),
    "2.6 Hz": _signal(Waveform.SINE, 120.0, 2.6, 0.0, 0.0),
    "multisine": _signal(Waveform.MULTISINE, 280.0, 0.4, 0.0, 1.1),
    "multisine, fast": _signal(Waveform.MULTISINE, 200.0, 0.8, 30.0, 2.3),
    "steps": _signal(Waveform.SMOOTH_STEP, 150.0, 0.4, 40.0, 0.0),
    "steps, fast": _signal(Waveform.SMOOTH_STEP, 120.0, 0.75, 0.0, 0.0),
}
ROUNDS, BENCHES = 5, 240
"""Of the training; new benches in each."""
LATENCY = 5
"""Samples from a decision to where it acts: what recordings of the graph on the emulator show in 97 % of the steps."""
EVERY = 8
"""Every so many is the emulator's default truth."""
HIDDEN, BATCH, RATE = 64, 2048, 3e-3
CHANGE = 400
"""Policy steps, 4 s: when a bench changes."""
CHANGES: Mapping[str, Mapping[str, Any]] = {
    "spring x 0.5": {"spring_stiffness": {"ratio": 0.5}},
    "spring x 2": {"spring_stiffness": {"ratio": 2.0}},
    "supply x 0.65": {"supply_pressure": {"ratio": 0.65}},
    "valve gain x 0.75": {"valve_gain": {"ratio": 0.75}},
    "valve gain x 1.25": {"valve_gain": {"ratio": 1.25}},
}
SCORED = 6000
"""Samples of the reference whose RMS the shares are of."""
SKIPPED = 100
"""Policy steps at the begin of a run on which nothing is trained."""
SETTINGS = EvaluationSettings(settle=2.0, measure=6.0)
LAW = vector_runs.fixed_gains(np.array(BASE_GAINS))
CONTROLLERS = {"compensated": "compensated", "learned": "with the residual"}
"""With their columns of the tables."""


@dataclass(frozen=True)
class Run:
    """Runs of n benches, one reference each."""

    error: FloatArray
    """N, shape (n, samples)."""
    tripped: FloatArray
    """Shape (n,)."""
    inputs: FloatArray
    """Of the network, shape (n, steps, INPUTS)."""
    needed: FloatArray
    """Corrections that turned out to be needed in the steps of `inputs`, shape (n, steps, OUTPUTS)."""


def fleet_of(configs: Sequence[TruthConfig], delays: Sequence[int] = (LATENCY,)) -> VectorBench:
    """Emulated benches; `delays`: samples from a decision to where it acts, by turns."""
    fleet = truth_fleet(configs)
    fleet.links["gain_delay"] = np.resize(delays, len(configs))
    return fleet


def run(
    fleet: VectorBench, signals: Sequence[ReferenceSignal], residual: Residual | None, seed: int,
    later: TruthConfig | None = None,
) -> Run:  # fmt: skip
    """Run bench i with reference i under the compensated law; `later`: what each bench is from `CHANGE` on."""
    cases = [Case(str(number), signal) for number, signal in enumerate(signals)]
    errors: list[FloatArray] = []
    asked: list[tuple[FloatArray, FloatArray]] = []
    tripped = np.zeros(len(cases), bool)
    runs = vector_runs.run(fleet, cases, LAW, SETTINGS, seed, Compensator(len(cases)), residual)
    for number, step in enumerate(runs):
        if later is not None and number == CHANGE:
            fleet.rows.parameters[:] = TruthPlant(later).parameters[0]
        tripped |= np.any(step.samples["flags"] & Flag.TRIPPED, axis=1)
        errors.append(step.samples["reference_force"] - step.samples["load_force"])
        if residual is not None:
            asked.append((residual.inputs.astype(np.float32), residual.needed.astype(np.float32)))
    error = np.concatenate(errors, axis=1)
    if residual is None:
        return Run(error, tripped, np.empty(0), np.empty(0))
    inputs, needed = (np.stack(one, axis=1) for one in zip(*asked, strict=True))
    pairs = np.stack((needed[:, CORRECTION_DELAY:-1], needed[:, CORRECTION_DELAY + 1 :]), axis=2)
    return Run(error, tripped, inputs[:, : pairs.shape[1]], pairs)


def drawn_signals(count: int, generator: np.random.Generator) -> list[ReferenceSignal]:
    """References of the training: sines of 0.3 to 3 Hz, multisines and smooth steps of 0.3 to 1 Hz, 60 to 300 N."""
    found = []
    for number in range(count):
        kind = (Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP)[number % 3]
        fastest, largest = (3.0 if kind is Waveform.SINE else 1.0), (200.0 if kind is Waveform.SMOOTH_STEP else 300.0)
        frequency = float(np.exp(generator.uniform(np.log(0.3), np.log(fastest))))
        amplitude = min(generator.uniform(60.0, largest), 4000.0 / (2.0 * np.pi * frequency))
        offset = generator.uniform(-80.0, 80.0) if generator.random() < 0.4 else 0.0
        phase = 0.0 if kind is Waveform.SMOOTH_STEP else generator.uniform(0.0, 6.28)
        found.append(_signal(kind, float(amplitude), frequency, float(offset), float(phase)))
    return found


def fitted(runs: Sequence[Run], steps: int, seed: int) -> Network:
    """Fit a network to the needed corrections of runs, each run's share over its own mean square."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    x = np.concatenate([one.inputs[:, SKIPPED:].reshape(-1, INPUT_COUNT) for one in runs])
    y = np.concatenate([one.needed[:, SKIPPED:].reshape(-1, OUTPUT_COUNT) for one in runs])
    squares = [np.mean(one.needed[:, SKIPPED:, 0] ** 2, axis=1) + 0.1 for one in runs]
    share = np.concatenate([np.repeat(1.0 / one, runs[0].needed.shape[1] - SKIPPED) for one in squares])
    mean, spread = x.mean(0), x.std(0) + 1e-3
    inputs, targets = torch.tensor((x - mean) / spread).clamp(-6.0, 6.0), torch.tensor(y)
    weight = torch.tensor(share.astype(np.float32))[:, None]
    sizes = (INPUT_COUNT, HIDDEN, HIDDEN, OUTPUT_COUNT)
    parts = [layer for a, b in pairwise(sizes) for layer in (torch.nn.Linear(a, b), torch.nn.SiLU())]
    model = torch.nn.Sequential(*parts[:-1])
    averaged = torch.optim.swa_utils.AveragedModel(
        model, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.998)
    )
    optimiser = torch.optim.AdamW(model.parameters(), RATE, weight_decay=0.02)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = RATE * max(1.0 - step / steps, 0.01)
        chosen = torch.randint(len(inputs), (BATCH,))
        noisy = inputs[chosen] + 0.05 * torch.randn(BATCH, INPUT_COUNT)
        loss = torch.mean(weight[chosen] * (model(noisy) - targets[chosen]) ** 2)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        averaged.update_parameters(model)
    linear = [part for part in averaged.module.children() if isinstance(part, torch.nn.Linear)]
    layers = tuple(
        (part.weight.detach().numpy().T.astype(float), part.bias.detach().numpy().astype(float)) for part in linear
    )
    return Network(mean.astype(float), spread.astype(float), layers)


def train(path: Path, steps: int, seed: int, *, yields: bool = False) -> None:
    """Train in rounds, each on the benches of all rounds so far; `yields`: every second bench's load does."""
    generator = np.random.default_rng(seed)
    runs: list[Run] = []
    network: Network | None = None
    for number in progress(range(ROUNDS), total=ROUNDS, label="rounds", unit="round"):
        truths = drawn_truths(BENCHES * (2 if number == 0 else 1), seed + 100 * (number + 1))
        contents = list(truths.values())
        if yields:
            contents[1::2] = list(yielding(truths, seed + number).values())[1::2]
        contents[::EVERY] = [{"profile": "default"}] * len(contents[::EVERY])
        configs = [truth_from_mapping(content) for content in contents]
        signals = drawn_signals(len(configs), generator)
        runs.append(run(fleet_of(configs, (4, 5, 6)), signals, Residual(len(configs), network), seed + number))
        network = fitted(runs, steps, seed)
        tensors = {"mean": network.mean, "spread": network.spread}
        for layer, (weight, bias) in enumerate(network.layers):
            tensors |= {f"weight_{layer}": weight, f"bias_{layer}": bias}
        small = {name: tensor.astype(np.float32) for name, tensor in tensors.items()}
        command = shlex.join(["python", "-m", "benchmarks.residual", *sys.argv[1:]])
        weights.save(path, small, {"structure": STRUCTURE, "training": {"command": command, "seed": seed}})


def score(config: TruthConfig, controller: str, seed: int, weights_file: Path | None) -> list[dict[str, Any]]:
    """Rows of `tracked` of a controller of `CONTROLLERS` on each of `REFERENCES`."""
    cases = [Case(name, signal) for name, signal in REFERENCES.items()]
    residual = Residual(len(cases), Network.load(weights_file)) if controller == "learned" else None
    return tracked(fleet_of([config] * len(cases)), cases, LAW, SETTINGS, Compensator(len(cases)), residual, seed=seed)


def compare(asked: argparse.Namespace) -> None:
    """Score a network on truths of a seed."""
    wanted = {
        f"{asked.seed} {truth} {name}": (truth_from_mapping(content), name, asked.seed, asked.weights)
        for truth, content in drawn_truths(asked.truths, asked.seed).items() for name in CONTROLLERS
    }  # fmt: skip
    version = b"" if asked.weights is None else asked.weights.read_bytes(), code_version()
    found = list(results(score, wanted, asked, version, label="runs", unit="run").values())
    rows = [found[k : k + len(CONTROLLERS)] for k in range(0, len(found), len(CONTROLLERS))]
    table(rows, f"Learned residual, {len(rows)} truths of seed {asked.seed}, after 2 s").show(asked.json)


def table(rows: Sequence[Sequence[Sequence[Mapping[str, Any]]]], title: str) -> Table:
    """Interquartile means over the truths; `rows`: of each truth those of the controllers in their order."""
    rmse, rate, tripped = (
        np.array([[[row[key] for row in run] for run in own] for own in rows])
        for key in ("rmse", "current_rate_rms", "tripped")
    )
    law, learned = rmse[:, 0], rmse[:, 1]
    ratio, worse = learned / law, learned > 1.1 * law + 0.3
    times = np.arange(SCORED) * SAMPLE_PERIOD
    sizes = [np.sqrt(np.mean(reference_force(signal, times)[0] ** 2)) for signal in REFERENCES.values()]
    share = 100.0 * rmse / sizes
    unit = "RMSE, N, % of the reference's RMS"
    columns = {"reference": "", **dict.fromkeys(CONTROLLERS.values(), unit), "ratio": "of the two",
               "low": "95 % interval of the ratio", "high": "", "largest": "ratio", "worse": "above 1.1 times + 0.3 N",
               "trips": "with the residual (without)", "u' ratio": "RMS of u' over the law's"}  # fmt: skip
    made = Table(columns, title=title)
    picks = np.random.default_rng(0).integers(len(rows), size=(1000, len(rows)))

    for name, chosen in (*((name, [k]) for k, name in enumerate(REFERENCES)), ("all", list(range(len(REFERENCES))))):
        own = ratio[:, chosen]
        low, high = np.percentile([interquartile_mean(own[pick].ravel()) for pick in picks], (2.5, 97.5)).tolist()
        means = ([interquartile_mean(one[:, k, chosen].ravel()) for one in (rmse, share)] for k in (0, 1))
        made.add(
            reference=name,
            **dict(zip(CONTROLLERS.values(), (f"{error:.2f}, {part:.2f} %" for error, part in means), strict=True)),
            ratio=interquartile_mean(own.ravel()), low=low, high=high, largest=float(own.max()),
            worse=f"{int(worse[:, chosen].sum())} of {own.size}",
            trips=f"{tripped[:, 1, chosen].sum():g} ({tripped[:, 0, chosen].sum():g})",
            **{"u' ratio": interquartile_mean((rate[:, 1] / rate[:, 0])[:, chosen].ravel())},
        )  # fmt: skip
    return made


def changed(weights_file: Path | None, seed: int) -> Table:
    """RMSE in the first second behind a change of the default truth, and from 2 s to 4 s behind it."""
    windows = {"first second": (CHANGE, CHANGE + 100), "2 s later": (CHANGE + 200, CHANGE + 400)}
    columns = {"change": "", "window": "", "compensated": "RMSE, N", "with the residual": "RMSE, N",
               "ratio": "of the two", "largest": "ratio", "trips": "with the residual (without)"}  # fmt: skip
    made = Table(columns, title="The default bench changes at 4 s")
    signals = list(REFERENCES.values())
    configs = [truth_from_mapping({"profile": "default"})] * len(signals)
    for name, effects in CHANGES.items():
        later = truth_from_mapping({"profile": "default", "effects": effects})
        residuals = (None, Residual(len(signals), Network.load(weights_file)))
        law, learned = (run(fleet_of(configs), signals, residual, seed, later) for residual in residuals)
        for window, (first, last) in windows.items():
            parts = (one.error[:, first * SAMPLES_PER_STEP : last * SAMPLES_PER_STEP] for one in (law, learned))
            rmse = [np.sqrt(np.mean(part**2, axis=1)) for part in parts]
            ratio = rmse[1] / rmse[0]
            made.add(
                change=name, window=window, compensated=interquartile_mean(rmse[0]), ratio=interquartile_mean(ratio),
                **{"with the residual": interquartile_mean(rmse[1])}, largest=float(ratio.max()),
                trips=f"{learned.tripped.sum():g} ({law.tripped.sum():g})",
            )  # fmt: skip
    return made


@command(OSError)
def main() -> None:
    """Score, or train."""
    options = parser("residual", __doc__, parallel=True)
    options.add_argument("--truths", type=int, default=40, metavar="COUNT", help="benches, default %(default)s")
    options.add_argument("--seed", type=int, default=4242, metavar="S", help="of the benches, default %(default)s")
    options.add_argument("--weights", type=Path, metavar="FILE", help="of the network (default: the shipped one)")
    options.add_argument(
        "--train", type=Path, metavar="FILE", help="train in place of scoring, and write these weights"
    )
    options.add_argument(
        "--steps", type=int, default=30000, metavar="N", help="of fitting in each of five rounds, default %(default)s"
    )
    options.add_argument("--yielding", action="store_true", help="train on loads that yield, too: every second bench")
    options.add_argument("--changes", action="store_true", help="the default truth that changes in mid-run, instead")
    asked = options.parse_args()
    if asked.train:
        train(asked.train, asked.steps, asked.seed, yields=asked.yielding)
    elif asked.changes:
        changed(asked.weights, asked.seed).show(asked.json)
    else:
        compare(asked)


if __name__ == "__main__":
    main()
