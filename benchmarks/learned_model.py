# SPDX-License-Identifier: Apache-2.0
"""The learned bench: training speed against a plain torch loop of the same model, rollouts, latency, closed loop.

Both loops run in one process on the same batch, as many threads each as there are cores. The closed loop compares the
shipped model with the emulator's default truth: 300 N sines under fixed gains, first 2 s left out, and the K_p from
which the error at 1 Hz is more than twice that at K_p = 90. `--training` times the whole default training as well.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import timeit
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import torch

from benchmarks._report import finish, parser
from hydro_bridge.signals import Flag, ReferenceSignal, StateArray, Waveform
from hydro_sim.emulator.offline import Segment, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import recordings
from hydro_sim.identification import stages, torch_gradients, training
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.neural import mlp, network
from hydro_sim.simulation.offline import Schedule, simulate
from hydro_sim.structured import observer, rollout
from hydro_sim.structured.model import StructuredModel

HORIZON = 70
FREQUENCIES = (0.5, 1.0, 1.5, 2.0)
GAINS = ((50.0, 15.0), (90.0, 15.0))


def _duel(mine: Callable[[], object], other: Callable[[], object], repeat: int) -> tuple[float, float]:
    """Median time [s] of each, taken in turns: other work on the machine hits both."""
    mine(), other()
    times = [(timeit.timeit(mine, number=1), timeit.timeit(other, number=1)) for _ in range(repeat)]
    return statistics.median(t[0] for t in times), statistics.median(t[1] for t in times)


def network_speed(windows: int) -> dict[str, float]:
    """One gradient of the paper's model: 2x32, H = 70, float32."""
    rng = np.random.default_rng(0)
    layers = mlp.layers(mlp.initial(rng, 9, (32, 32), 8).astype(np.float32), 9, (32, 32), 8)
    shapes = (windows, 8), (windows, HORIZON), (windows, HORIZON, 8)
    step = np.full(8, 0.05, np.float32)
    parts = [rng.standard_normal(shape).astype(np.float32) for shape in shapes]
    threads = numba.get_num_threads()
    mine, other = _duel(
        lambda: network.loss_and_gradient(layers, step, *parts, False, threads),
        lambda: torch_gradients.network_loss(layers, step, *parts, False),
        15,
    )
    return {"windows": windows, "seconds": mine, "torch_seconds": other, "ratio": other / mine}


def structured_speed(model: StructuredModel, windows: int) -> dict[str, float]:
    """One gradient of the shipped model: H = 70, float64."""
    c, layers, center, scale, _ = model.compiled
    rng = np.random.default_rng(0)
    starts = np.repeat(model.rest[None, :9], windows, axis=0)
    currents = 2e-3 * rng.standard_normal((windows, HORIZON))
    targets = np.zeros((windows, HORIZON, 5))
    parts = c, layers, center, scale, starts, currents, targets, 1.0 / observer.READING_NOISE
    mine, other = _duel(
        lambda: rollout.loss_and_gradients(*parts, numba.get_num_threads()),
        lambda: torch_gradients.structured_loss(*parts),
        3,
    )
    return {"windows": windows, "seconds": mine, "torch_seconds": other, "ratio": other / mine}


def rollouts(learned: Learned) -> dict[str, float]:
    """State-steps per second of batch rollouts, and one step of the plant [us]."""
    model, rng = learned.model, np.random.default_rng(0)
    windows = 2000
    starts, currents = np.repeat(model.rest[None], windows, axis=0), 1e-3 * rng.standard_normal((windows, HORIZON))
    model.predict(starts, currents)
    taken = min(timeit.repeat(lambda: model.predict(starts, currents), number=1, repeat=5))
    plant = LearnedPlant(learned)
    steps = []
    for k in range(20_000):
        begin = time.perf_counter()
        plant.step(1e-3 * np.sin(0.01 * k))
        steps.append(time.perf_counter() - begin)
    p50, p99 = 1e6 * np.quantile(steps, [0.5, 0.99])
    return {"state_steps_per_s": windows * HORIZON / taken, "step_p50_us": float(p50), "step_p99_us": float(p99)}


def _rmse(states: StateArray) -> float:
    if np.any(states["flags"] & Flag.TRIPPED):
        return float("inf")
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"])[2000:] ** 2)))


def simulated(learned: Learned) -> Callable[[tuple[float, float], float], float]:
    """(gains, frequency) -> RMSE of e [N] over 10 s of the learned bench."""
    plant, bench = LearnedPlant(learned), Bench.nominal()

    def run(gains: tuple[float, float], frequency: float) -> float:
        signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=frequency)
        return _rmse(simulate(plant, bench, Schedule(reference=signal, gains=gains, seconds=12.0), seed=1))

    return run


def emulated(gains: tuple[float, float], frequency: float) -> float:
    """The same on the emulator."""
    segment = Segment(seconds=12.0, amplitude=300.0, frequency=frequency, kp=gains[0], ki=gains[1])
    return _rmse(record_offline(profile("default"), [segment], seed=2).states)


def unstable_gain(run: Callable[[tuple[float, float], float], float]) -> float:
    """K_p [1/s] from which the error at 1 Hz is more than twice that at 90, to 0.5."""
    low, high, limit = 90.0, 290.0, 2.0 * run((90.0, 15.0), 1.0)
    while high - low > 0.5:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run((middle, 15.0), 1.0) <= limit else (low, middle)
    return high


def closed_loop(learned: Learned) -> dict[str, Any]:
    """Learned bench beside emulator."""
    run, rows = simulated(learned), []
    for gains in GAINS:
        for frequency in FREQUENCIES:
            mine, truth = run(gains, frequency), emulated(gains, frequency)
            rows.append({"kp": gains[0], "frequency": frequency, "simulated": mine, "emulated": truth})
            shown = f"{mine:.2f} N simulated, {truth:.2f} N emulated ({mine / truth - 1:+.2%})"
            print(f"K_p {gains[0]:g}, {frequency:g} Hz: {shown}")
    gain, truth = unstable_gain(run), unstable_gain(emulated)
    print(f"unstable from K_p = {gain:.1f} simulated, {truth:.1f} emulated ({gain / truth - 1:+.2%})")
    return {"rmse_N": rows, "unstable_kp": {"simulated": gain, "emulated": truth}}


def default_training() -> float:
    """Seconds of the default training on 10 minutes of the emulator's offline recordings."""
    states = {
        str(seed): record_offline(profile("default"), draw(150.0, seed), seed=seed).states for seed in (1, 2, 3, 4, 5)
    }
    data, settings = recordings.split(states), training.Settings(adam=training.STRUCTURED_ADAM)
    began = time.monotonic()
    model = training.start(data, settings, Bench.nominal())
    assert isinstance(model, StructuredModel)
    model = stages.fit_constants(model, data, settings.identify_windows, settings.seed, lambda _: None)
    for _ in training.steps(model, data, settings):
        pass
    return time.monotonic() - began


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    options: argparse.ArgumentParser = parser("learned_model", __doc__)
    options.add_argument("--training", action="store_true", help="also time the default training: minutes")
    options.add_argument("--windows", type=int, default=8192, help="batch of the network's gradient")
    asked = options.parse_args(arguments)
    torch.set_num_threads(numba.get_num_threads())
    learned = Learned.load()
    result: dict[str, Any] = {"threads": numba.get_num_threads(), "rollouts": rollouts(learned)}
    result["network_gradient"] = network_speed(asked.windows)
    if isinstance(learned.model, StructuredModel):
        result["structured_gradient"] = structured_speed(learned.model, asked.windows // 8)
    for key in ("rollouts", "network_gradient", "structured_gradient"):
        print(f"{key}: " + ", ".join(f"{name} {value:.4g}" for name, value in result.get(key, {}).items()))
    result["closed_loop"] = closed_loop(learned)
    if asked.training:
        result["default_training_s"] = default_training()
        print(f"default training: {result['default_training_s']:.0f} s")
    finish(result, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
