# SPDX-License-Identifier: Apache-2.0
"""Validation cases: gains over time and a reference, by case and seed (paper, Learned Metric Validation); benches.

The emulator's plant is identical, sample for sample, to the one behind the serial line, except for its clock. Nothing
else in this package imports the emulator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray, ReferenceSignal, Waveform
from hydro_sim.emulator.truth.config import profile, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import NOMINAL
from hydro_sim.model.plant import Plant

CHANGES: dict[str, dict[str, float]] = {
    "emulator": {},
    "spring 10 kN/m": {"spring_stiffness": 1e4},
    "spring 30 kN/m": {"spring_stiffness": 3e4},
    "supply 12 MPa": {"supply_pressure": 12e6},
}
"""Emulated benches and their changes, while filter and box assume the nominal one."""

PLANTS = (*CHANGES, "sim")


def plant_named(name: str, model: str | None = None) -> Plant:
    """One of `PLANTS`; `model`: bench file of the learned simulation, the shipped one by default."""
    if name == "sim":
        return make_plant(model)
    if not CHANGES[name]:
        return TruthPlant(profile("default"))
    return TruthPlant(truth_from_mapping({"profile": "default", "bench": CHANGES[name]}))


SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=NOMINAL.force * 2.0 / 3.0, frequency=1.0)
FAST = ReferenceSignal(waveform=Waveform.SINE, amplitude=NOMINAL.force, frequency=2.0)
Box = tuple[tuple[float, float], tuple[float, float]]
"""Ranges of K_p [1/s] and K_i [1/s^2]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case: gains over time, and the reference."""

    name: str
    about: str
    gains: Callable[[np.random.Generator, int], FloatArray]
    """Generator and policy steps to K_p, K_i, shape (steps, 2)."""
    reference: ReferenceSignal = SINE
    stable: bool = False
    """Whether the unfiltered loop is stable, so that the filter should not act."""

    def draw(self, seed: int, seconds: float) -> FloatArray:
        """Gains of a run, shape (policy steps, 2)."""
        return self.gains(np.random.default_rng(seed), round(seconds / (SAMPLES_PER_STEP * SAMPLE_PERIOD)))


def constant_gains(kp: float, ki: float) -> Callable[[np.random.Generator, int], FloatArray]:
    """One pair of gains."""
    return lambda rng, steps: np.tile((kp, ki), (steps, 1))


def random_gains(box: Box, every: int) -> Callable[[np.random.Generator, int], FloatArray]:
    """Random gains, redrawn every `every` policy steps of 10 ms; 0: once."""

    def gains(rng: np.random.Generator, steps: int) -> FloatArray:
        span = every or steps
        draws = -(-steps // span)
        pairs = np.column_stack([rng.uniform(*box[0], draws), rng.uniform(*box[1], draws)])
        return np.repeat(pairs, span, axis=0)[:steps]

    return gains


def switching_gains(low: float, high: float, every: int) -> Callable[[np.random.Generator, int], FloatArray]:
    """K_p that switches between two values every `every` policy steps, from a random step on."""

    def gains(rng: np.random.Generator, steps: int) -> FloatArray:
        phase = (np.arange(steps) + int(rng.integers(2 * every))) // every % 2
        return np.column_stack([np.where(phase == 0, low, high), np.full(steps, 15.0)])

    return gains


UNSTABLE: Box = ((-40.0, 40.0), (-5.0, 5.0))
NEGATIVE: Box = ((-40.0, 0.0), (-5.0, 0.0))
POSITIVE: Box = ((0.0, 40.0), (0.0, 5.0))
HIGH: Box = ((100.0, 300.0), (5.0, 15.0))
WIDE: Box = ((-40.0, 300.0), (-5.0, 15.0))

CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case(name="stable", about="K_p 90, K_i 15 (paper)", gains=constant_gains(90.0, 15.0), stable=True),
        Case(
            name="stable-fast",
            about="the same, 300 N at 2 Hz",
            gains=constant_gains(90.0, 15.0),
            reference=FAST,
            stable=True,
        ),
        Case(name="base", about="K_p 15, K_i 5", gains=constant_gains(15.0, 5.0), stable=True),
        Case(
            name="unstable",
            about="K_p -40 to 40, K_i -5 to 5, drawn every 10 ms (paper)",
            gains=random_gains(UNSTABLE, 1),
        ),
        Case(name="unstable-slow", about="the same, drawn every 0.5 s", gains=random_gains(UNSTABLE, 50)),
        Case(name="negative", about="K_p -40 to 0, K_i -5 to 0, drawn every 10 ms", gains=random_gains(NEGATIVE, 1)),
        Case(name="negative-held", about="the same, drawn once", gains=random_gains(NEGATIVE, 0)),
        Case(name="positive", about="K_p 0 to 40, K_i 0 to 5, drawn every 10 ms", gains=random_gains(POSITIVE, 1)),
        Case(name="high", about="K_p 100 to 300, K_i 5 to 15, drawn once", gains=random_gains(HIGH, 0)),
        Case(name="high-fast", about="the same, 300 N at 2 Hz", gains=random_gains(HIGH, 0), reference=FAST),
        Case(name="highest", about="K_p 300, K_i 15", gains=constant_gains(300.0, 15.0)),
        Case(name="wide", about="K_p -40 to 300, K_i -5 to 15, drawn every 10 ms", gains=random_gains(WIDE, 1)),
        Case(name="wide-slow", about="the same, drawn every 0.5 s", gains=random_gains(WIDE, 50)),
        Case(name="switched", about="K_p 15 and 300 in turn, each for 10 ms", gains=switching_gains(15.0, 300.0, 1)),
        Case(
            name="switched-slow", about="K_p 15 and 300 in turn, each for 0.5 s", gains=switching_gains(15.0, 300.0, 50)
        ),
    )
}
