# SPDX-License-Identifier: Apache-2.0
"""The bench as one model: textbook equations and the bench file's effects, simulated and differentiated exactly.

::

    model = BenchModel(Bench.load("corrected.yaml"))
    k, y, z = model.begin(model.values)           coefficients; a still bench; its readings f_h f_l p_a p_b x_p
    z = model.sample(k, y, 1e-3)                  one box sample at 1 mA; y moves on in place
    z, dy, dz = model.jacobian(k, y, 1e-3)        the same, with d y/d(y, u) and d z/d(y, u)
    loss, gy, gk = model.window(k, y, u, targets, weights)      a prediction's error and its gradients
    gtheta = model.gradient(model.values, gk)     by the parameters

What a model does is compiled C, made by `model.assembly` and `model.source` from the equations and the effects' terms,
and kept by `model.machine_code`; the numbers of a bench are no part of it.
"""

from __future__ import annotations

import ctypes
import sys
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from importlib.metadata import version
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.model import machine_code
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import catalogue, valve

if TYPE_CHECKING:
    from hydro_sim.model.assembly import Functions

SUBSTEPS = 20
"""Integration steps per sample: 50 us, a 220th of a period of the 90 Hz mass-on-oil mode."""

PASTS = (0, 4, 8, 16, 32, 64)
"""Past currents that a model may keep: as many as its dead time needs at least."""

DEAD_TIME = f"{valve.TransportDelay.id}.time"
"""The parameter that `PASTS` has room for."""

TEXTBOOK = 6
"""States of the textbook's equations: p_a, p_b, x_p, x_p', and f_l behind its amplifier with its rate."""

READINGS = 5


@dataclass(frozen=True)
class Named:
    """A parameter of a model."""

    name: str
    """As in bench.yaml; of an effect: its label, a dot, and the parameter."""
    unit: str
    low: float
    high: float
    scale: float
    """A typical size: the standard deviation of what is believed before any recording."""


@dataclass(frozen=True)
class State:
    """A state of a model."""

    name: str
    unit: str
    scale: float


class BenchModel:
    """See the module.

    Parameters
    ----------
    bench
        Numbers and effects.
    substeps
        Integration steps per sample, an even number.
    """

    def __init__(self, bench: Bench, *, substeps: int = SUBSTEPS) -> None:
        self.bench, self.substeps = bench, substeps
        kinds = [catalogue.kind_of(effect) for effect in bench.terms]
        self.parameters = tuple(_numbers(bench)) + tuple(
            Named(f"{catalogue.label(effect)}.{one.name}", one.unit, one.low, one.high, one.scale)
            for effect, (kind, _) in zip(bench.terms, kinds, strict=True)
            for one in kind.parameters
        )
        numbers = [float(getattr(bench, entry.name) or 0.0) for entry in fields(bench) if entry.metadata]
        self.values: FloatArray = np.array(numbers + [value for _, values in kinds for value in values])
        """The parameters' values in the bench file."""
        self.structure = structure_of(bench, substeps)
        past = self.structure.past
        self._code = library(self.structure)
        hidden = [State(one.name, one.unit, one.scale) for kind, _ in kinds for one in kind.effect.states]
        self.states = (*_TEXTBOOK, *hidden, *(State(f"current {i} samples ago", "A", 1e-2) for i in range(past)))
        self.address = ctypes.cast(self._code.bench_sample, ctypes.c_void_p).value or 0
        """Of `bench_sample`, for `machine_code.sample`."""
        self.coefficients = ctypes.c_long.in_dll(self._code, "bench_coefficients").value

    def address_of(self, name: str) -> int:
        """Where a function of the compiled code lies in this process, for `machine_code`: "bench_jacobian"."""
        code = self._derivatives if name in ("bench_jacobian", "bench_window") else self._code
        return ctypes.cast(getattr(code, name), ctypes.c_void_p).value or 0

    def begin(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Coefficients k, and states y and readings z of a still bench with a relaxed spring and p_a + p_b = p_s."""
        delays = [value for one, value in zip(self.parameters, theta, strict=True) if one.name == DEAD_TIME]
        if sum(delays) > max(self.structure.past - 2, 0) * SAMPLE_PERIOD:
            raise ValueError("a dead time is above the bench file's: make a model of a bench file with the longer one")
        k, y, z = np.empty(self.coefficients), np.zeros(len(self.states)), np.empty(READINGS)
        y[:TEXTBOOK] = rest_state(self.bench)
        self._code.bench_begin(to_c(theta, (len(self.parameters),)), to_c(k), to_c(y), to_c(z))
        return k, y, z

    def sample(self, k: FloatArray, y: FloatArray, current: float) -> FloatArray:
        """Readings z, shape (5,), after a sample at a held current [A]; y, shape (states,), moves on in place."""
        z = np.empty(READINGS)
        self._code.bench_sample(*self._at(k, y), ctypes.c_double(current), to_c(z))
        return z

    def rollout(self, k: FloatArray, y: FloatArray, currents: FloatArray) -> FloatArray:
        """Readings after each of n samples, shape (n, 5); y moves on in place."""
        z = np.empty((len(currents), READINGS))
        n = len(currents)
        self._code.bench_rollout(*self._at(k, y), ctypes.c_long(n), to_c(currents, (n,)), to_c(z))
        return z

    def jacobian(self, k: FloatArray, y: FloatArray, current: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `sample`; and d y/d(y, u), shape (states, states + 1), and d z/d(y, u), shape (5, states + 1)."""
        width = len(self.states) + 1
        z, dy, dz = np.empty(READINGS), np.empty((width - 1, width)), np.empty((READINGS, width))
        self._derivatives.bench_jacobian(*self._at(k, y), ctypes.c_double(current), to_c(z), to_c(dy), to_c(dz))
        return z, dy, dz

    def window(
        self, k: FloatArray, y: FloatArray, currents: FloatArray, targets: FloatArray, weights: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Sum of (weight (reading - target))^2 of a prediction from y, and its gradients by y and by k.

        Shapes: currents (n,) [A], targets (n, 5), weights (5,).
        """
        gy, gk = np.empty_like(y), np.zeros_like(k)
        room = np.empty((len(currents) + 1, len(y)))
        n, at = len(currents), self._at(k, y)
        words = [ctypes.c_long(n), to_c(currents, (n,)), to_c(targets, (n, READINGS)), to_c(weights, (READINGS,))]
        return self._derivatives.bench_window(*at, *words, to_c(gy), to_c(gk), to_c(room)), gy, gk

    def gradient(self, theta: FloatArray, gk: FloatArray) -> FloatArray:
        """A gradient by the parameters, of one by the coefficients."""
        gtheta = np.empty_like(theta)
        self._derivatives.bench_once_back(
            to_c(theta, (len(self.parameters),)), to_c(gk, (self.coefficients,)), to_c(gtheta)
        )
        return gtheta

    def _at(self, k: FloatArray, y: FloatArray) -> tuple[ctypes.c_void_p, ctypes.c_void_p]:
        return to_c(k, (self.coefficients,)), to_c(y, (len(self.states),))

    def symbols(self) -> Functions:
        """The model's functions as CasADi's symbols."""
        return _assembled(self.structure)

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (self.bench, self.substeps)

    @cached_property
    def _derivatives(self) -> ctypes.CDLL:
        """The code with derivatives: five times as long to compile, and not needed by a simulation."""
        return library(self.structure, "derivatives")

    @property
    def source(self) -> str:
        """The model's C: what a box can run."""
        return _source(self.structure, "derivatives")


@dataclass(frozen=True)
class Structure:
    """Structure of a model: everything that its generated code depends on, without parameter values."""

    labels: tuple[str, ...]
    ideal_cell: bool
    past: int
    substeps: int


def structure_of(bench: Bench, substeps: int = SUBSTEPS) -> Structure:
    """Structure of a bench's model: the same for all benches with these effects, in this order."""
    labels = tuple(catalogue.label(effect) for effect in bench.terms)
    return Structure(labels, bench.load_cell_bandwidth is None, _past(catalogue.delay(bench.effects)), substeps)


def _made(bench: Bench, substeps: int) -> BenchModel:
    return BenchModel(bench, substeps=substeps)


def rest_state(bench: Bench) -> FloatArray:
    """Textbook states, shape (6,), of a still bench with a relaxed spring and p_a + p_b = p_s."""
    numbers = bench.constants()[0]
    pressure_b = numbers["supply_pressure"] / (1.0 + numbers["area_ratio"])
    return np.array([numbers["area_ratio"] * pressure_b, pressure_b, numbers["spring_rest_position"], 0.0, 0.0, 0.0])


_TEXTBOOK = (
    State("pressure_a", "Pa", 1e6), State("pressure_b", "Pa", 1e6), State("piston_position", "m", 1e-2),
    State("piston_velocity", "m/s", 0.1), State("load_force", "N", 100.0), State("load_force_rate", "N/s", 1e3),
)  # fmt: skip


def _numbers(bench: Bench) -> list[Named]:
    entries = [(entry, entry.metadata) for entry in fields(bench) if entry.metadata]
    return [
        Named(entry.name, about["unit"], about["low"], about["high"], 0.1 * abs(getattr(bench, entry.name) or 0.0))
        for entry, about in entries
    ]


def _past(delay: float) -> int:
    needed = ceil(delay / SAMPLE_PERIOD) + 2 if delay > 0.0 else 0
    return next(past for past in PASTS if past >= needed)


Part = Literal["", "derivatives", "sensitivities"]
"""What a library has beside the simulation: `BenchModel`'s derivatives, or what `model.sensitivities` calls."""


@lru_cache(maxsize=256)
def library(structure: Structure, part: Part = "") -> ctypes.CDLL:
    """Compiled library of a structure; compiled on first use."""
    code = machine_code.cached_library(
        _name(structure, part), lambda: _source(structure, part), said=lambda: _say(structure)
    )
    if part == "derivatives":
        code.bench_window.restype = ctypes.c_double
    return code


def is_compiled(structure: Structure, part: Part = "") -> bool:
    """Return whether `library` finds its code."""
    return machine_code.library_path(_name(structure, part)).exists()


def _name(structure: Structure, part: Part) -> str:
    return f"{structure} {part} {_sources_digest()}"


def _say(structure: Structure) -> None:
    what = ", ".join(structure.labels) or "no effects"
    print(f"compiling the model of a bench with {what}: some seconds, once", file=sys.stderr, flush=True)


@lru_cache(maxsize=8)
def _assembled(structure: Structure) -> Functions:
    from hydro_sim.model.assembly import Assembly  # only what is not compiled yet waits for CasADi

    effects = [catalogue.KINDS[label].make() for label in structure.labels]
    made = Assembly(
        _limits(), effects, ideal_cell=structure.ideal_cell, past=structure.past, substeps=structure.substeps
    )
    return made.functions()


def _limits() -> dict[str, tuple[float, float]]:
    """Names of a bench's numbers, with the range of each."""
    return {entry.name: (entry.metadata["low"], entry.metadata["high"]) for entry in fields(Bench) if entry.metadata}


def _source(structure: Structure, part: Part) -> str:
    from hydro_sim.model.source import c_source

    asked = {"derivatives": part == "derivatives", "sensitivities": part == "sensitivities"}
    return c_source(_assembled(structure), structure.substeps, **asked)


@lru_cache(maxsize=1)
def _sources_digest() -> str:
    """Of all that a model's code is written from."""
    import hashlib

    here = Path(__file__).parent
    names = ["equations.py", "laws.py", "grammar.py", "motion.py", "rates.py", "assembly.py", "source.py"]
    files = [here / name for name in names] + sorted(here.glob("*.c")) + sorted((here / "effects").glob("*.py"))
    others = f"{SAMPLE_PERIOD} {_limits()} casadi {version('casadi')}".encode()
    return hashlib.sha256(b"".join([*(file.read_bytes() for file in files), others])).hexdigest()


def to_c(array: FloatArray, shape: tuple[int, ...] | None = None) -> ctypes.c_void_p:
    """Where an array's float64 numbers lie; ValueError if it is not what compiled code reads."""
    if array.dtype != np.float64 or not array.flags.c_contiguous:
        raise ValueError(f"an array of {array.dtype} and strides {array.strides} is not one of adjacent float64")
    if shape is not None and array.shape != shape:
        raise ValueError(f"an array has shape {array.shape}, the model needs {shape}")
    return ctypes.c_void_p(array.ctypes.data)
