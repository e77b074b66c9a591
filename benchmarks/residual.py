# SPDX-License-Identifier: Apache-2.0
"""The learned residual on the compensated law: trained on drawn benches, scored on others.

    python -m benchmarks.residual --truths 40 --seed 4242 --json residual.json      scores the shipped one: minutes
    python -m benchmarks.residual --train residual.safetensors --minutes 15         trains another

Each truth tracks each of nine references, none of them among those of the training, once under the compensated law
alone and once with the residual. Training runs new benches and references under the network of the round before, and
fits the corrections that turn out to have been needed (dataset aggregation: Ross, Gordon, Bagnell 2011, AISTATS).

Interquartile means over all pairs, with 95 % bootstrap intervals over the truths; u' is the current's rate.
"""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from benchmarks import _truth_fleet  # noqa: F401 - registers the truth plant
from benchmarks._drawn_truths import drawn_truths
from benchmarks._report import parser
from benchmarks.controllers import interquartile_mean
from hydro_bridge.cli.console import Table, progress
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray, Law, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import ADAPTS, Compensator
from hydro_policy.compensation.residual import DELAY, INPUTS, OUTPUTS, STRUCTURE, Network, Residual
from hydro_policy.envs.vector_env import VectorBench
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.truth.config import TruthConfig, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.files import weights
from hydro_sim.model.bench import Bench


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
SECONDS, SETTLED = 8.0, 2.0
BENCHES = 240
"""New ones in each round of the training."""
LATENCY = 5
"""Samples from a decision to where it acts: what recordings of the graph on the emulator show in 97 % of the steps."""
EVERY = 8
"""Every so many is the emulator's default truth."""
HIDDEN, BATCH, RATE = 64, 2048, 3e-3
SKIPPED = 100
"""Policy steps at the begin of a run on which nothing is trained."""


@dataclass(frozen=True)
class Run:
    """Runs of n benches, one reference each."""

    error: FloatArray
    """N, shape (n, samples)."""
    current: FloatArray
    """A, shape (n, samples)."""
    tripped: FloatArray
    """Shape (n,)."""
    inputs: FloatArray
    """Of the network, shape (n, steps, INPUTS)."""
    needed: FloatArray
    """Corrections that turned out to be needed in the steps of `inputs`, shape (n, steps, OUTPUTS)."""


def run(
    configs: Sequence[TruthConfig],
    signals: Sequence[ReferenceSignal],
    residual: Residual | None,
    seed: int,
    delays: Sequence[int] = (LATENCY,),
) -> Run:
    """Run bench i with reference i under the compensated law, with the residual or without one.

    `delays`: samples from a decision to where it acts, by turns.
    """
    count, steps, law = len(configs), round(SECONDS / SAMPLE_PERIOD) // SAMPLES_PER_STEP, BoxLaw()
    fleet = VectorBench([Bench.nominal()] * count, [TruthPlant(config) for config in configs], BoxConfig())
    fleet.links["gain_delay"] = np.resize(delays, count)
    for row, signal in enumerate(signals):
        fleet.begin(row, signal, 1000 * seed + row, law=Law.COMPENSATED)
    estimator, still = Compensator(count), np.zeros((count, 2))
    low, high = law.coefficient_min[3], law.coefficient_max[3]
    error, current = (np.zeros((count, steps, SAMPLES_PER_STEP)) for _ in range(2))
    inputs, needed = np.zeros((count, steps, INPUTS), np.float32), np.zeros((count, steps), np.float32)
    tripped, added = np.zeros(count, bool), np.zeros(count)
    for step in range(steps):
        commanded = estimator.coefficients.copy()
        commanded[:, 3] = np.clip(commanded[:, 3] + added, low, high)
        added = commanded[:, 3] - estimator.coefficients[:, 3]
        samples = fleet.step(still, commanded)
        force, reference, rate = (samples[name] for name in ("load_force", "reference_force", "reference_force_rate"))
        hidden = (0.0, 0.0) if residual is None else residual.hidden(added)
        active = np.all(samples["flags"] & ADAPTS == Flag.ARMED, axis=1)
        law_now = estimator.step(fleet.compensated - hidden[0], force - hidden[1], active, rate)
        if residual is not None:
            added = residual.step(reference, rate, force, law_now, estimator.counted)
            inputs[:, step], needed[:, step] = residual.inputs, residual.needed
        tripped |= np.any(samples["flags"] & Flag.TRIPPED, axis=1)
        error[:, step], current[:, step] = reference - force, samples["valve_current"]
    pairs = np.stack((needed[:, DELAY:-1], needed[:, DELAY + 1 :]), axis=2)
    return Run(error.reshape(count, -1), current.reshape(count, -1), tripped, inputs[:, : pairs.shape[1]], pairs)


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


def fitted(runs: Sequence[Run], seconds: float, seed: int) -> Network:
    """Fit a network to the needed corrections of runs, each run's share over its own mean square."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    x = np.concatenate([one.inputs[:, SKIPPED:].reshape(-1, INPUTS) for one in runs])
    y = np.concatenate([one.needed[:, SKIPPED:].reshape(-1, OUTPUTS) for one in runs])
    squares = [np.mean(one.needed[:, SKIPPED:, 0] ** 2, axis=1) + 0.1 for one in runs]
    share = np.concatenate([np.repeat(1.0 / one, runs[0].needed.shape[1] - SKIPPED) for one in squares])
    mean, spread = x.mean(0), x.std(0) + 1e-3
    inputs, targets = torch.tensor((x - mean) / spread).clamp(-6.0, 6.0), torch.tensor(y)
    weight = torch.tensor(share.astype(np.float32))[:, None]
    sizes = (INPUTS, HIDDEN, HIDDEN, OUTPUTS)
    parts = [layer for a, b in pairwise(sizes) for layer in (torch.nn.Linear(a, b), torch.nn.SiLU())]
    model = torch.nn.Sequential(*parts[:-1])
    averaged = torch.optim.swa_utils.AveragedModel(
        model, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.998)
    )
    optimiser = torch.optim.AdamW(model.parameters(), RATE, weight_decay=0.02)
    began = time.monotonic()
    while (gone := (time.monotonic() - began) / seconds) < 1.0:
        optimiser.param_groups[0]["lr"] = RATE * max(1.0 - gone, 0.01)
        chosen = torch.randint(len(inputs), (BATCH,))
        noisy = inputs[chosen] + 0.05 * torch.randn(BATCH, INPUTS)
        loss = torch.mean(weight[chosen] * (model(noisy) - targets[chosen]) ** 2)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        averaged.update_parameters(model)
    linear = [part for part in averaged.module if isinstance(part, torch.nn.Linear)]
    layers = tuple(
        (part.weight.detach().numpy().T.astype(float), part.bias.detach().numpy().astype(float)) for part in linear
    )
    return Network(mean.astype(float), spread.astype(float), layers)


def train(path: Path, minutes: float, seed: int, rounds: int = 5) -> None:
    """Train in rounds, each on the benches of all rounds so far; write the weights."""
    generator = np.random.default_rng(seed)
    runs: list[Run] = []
    network: Network | None = None
    for number in progress(range(rounds), total=rounds, label="rounds", unit="round"):
        contents = list(drawn_truths(BENCHES * (2 if number == 0 else 1), seed + 100 * (number + 1)).values())
        contents[::EVERY] = [{"profile": "default"}] * len(contents[::EVERY])
        configs = [truth_from_mapping(content) for content in contents]
        signals = drawn_signals(len(configs), generator)
        runs.append(run(configs, signals, Residual(len(configs), network), seed + number, (4, 5, 6)))
        network = fitted(runs, 60.0 * minutes / rounds, seed)
        save(path, network, seed)


def save(path: Path, network: Network, seed: int) -> None:
    """Write a network as weights."""
    tensors = {"mean": network.mean, "spread": network.spread}
    for number, (weight, bias) in enumerate(network.layers):
        tensors |= {f"weight_{number}": weight, f"bias_{number}": bias}
    small = {name: tensor.astype(np.float32) for name, tensor in tensors.items()}
    command = shlex.join(["python", "-m", "benchmarks.residual", *sys.argv[1:]])
    weights.save(path, small, {"structure": STRUCTURE, "training": {"command": command, "seed": seed}})


def scores(found: Run) -> tuple[FloatArray, FloatArray]:
    """RMSE [N] and RMS of u' [A/s], shape (n,)."""
    first = round(SETTLED / SAMPLE_PERIOD)
    rates = np.diff(found.current[:, first:]) / SAMPLE_PERIOD
    return np.sqrt(np.mean(found.error[:, first:] ** 2, axis=1)), np.sqrt(np.mean(rates**2, axis=1))


def compare(count: int, seed: int, network: Network, json: Path | None) -> None:
    """Score a network on truths of a seed."""
    truths = [truth_from_mapping(one) for one in drawn_truths(count, seed).values()]
    configs, signals = [one for one in truths for _ in REFERENCES], list(REFERENCES.values()) * count
    alone, both = run(configs, signals, None, seed), run(configs, signals, Residual(len(configs), network), seed)
    (law, law_rate), (with_it, rate) = scores(alone), scores(both)
    ratio = (with_it / law).reshape(count, -1)
    columns = {"reference": "", "compensated": "RMSE, N", "with the residual": "RMSE, N", "ratio": "of the two",
               "low": "95 % interval of the ratio", "high": "", "largest": "ratio", "worse": "above 1.1 times + 0.3 N",
               "trips": "with the residual (without)", "u' ratio": "RMS of u' over the law's"}  # fmt: skip
    table = Table(columns, title=f"Learned residual, {count} truths of seed {seed}")
    generator = np.random.default_rng(0)
    picks = generator.integers(count, size=(1000, count))
    shaped = [one.reshape(count, -1) for one in (law, with_it, rate / law_rate, with_it > 1.1 * law + 0.3)]
    trips = [one.tripped.reshape(count, -1) for one in (both, alone)]
    for name, chosen in (*((name, [k]) for k, name in enumerate(REFERENCES)), ("all", list(range(len(REFERENCES))))):
        spread = [interquartile_mean(ratio[pick][:, chosen].ravel()) for pick in picks]
        table.add(
            reference=name, compensated=interquartile_mean(shaped[0][:, chosen].ravel()),
            **{"with the residual": interquartile_mean(shaped[1][:, chosen].ravel())},
            ratio=interquartile_mean(ratio[:, chosen].ravel()), low=float(np.percentile(spread, 2.5)),
            high=float(np.percentile(spread, 97.5)), largest=float(ratio[:, chosen].max()),
            worse=f"{int(shaped[3][:, chosen].sum())} of {count * len(chosen)}",
            trips=f"{int(trips[0][:, chosen].sum())} ({int(trips[1][:, chosen].sum())})",
            **{"u' ratio": interquartile_mean(shaped[2][:, chosen].ravel())},
        )  # fmt: skip
    table.show(json)


def main(arguments: list[str] | None = None) -> int:
    """Score, or train."""
    options = parser("residual", __doc__)
    options.add_argument("--truths", type=int, default=40, metavar="COUNT", help="benches, default %(default)s")
    options.add_argument("--seed", type=int, default=4242, metavar="S", help="of the benches, default %(default)s")
    options.add_argument("--weights", type=Path, metavar="FILE", help="of the network (default: the shipped one)")
    options.add_argument(
        "--train", type=Path, metavar="FILE", help="train in place of scoring, and write these weights"
    )
    options.add_argument("--minutes", type=float, default=15.0, metavar="M", help="of fitting, default %(default)s")
    asked = options.parse_args(arguments)
    if asked.train:
        train(asked.train, asked.minutes, asked.seed)
        return 0
    compare(asked.truths, asked.seed, Network.load(asked.weights), asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
