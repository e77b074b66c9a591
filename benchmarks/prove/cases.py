# SPDX-License-Identifier: Apache-2.0
"""Sealed cases, drawn from one seed: benches with up to three concealed causes, and their excitation.

A size is drawn evenly on a logarithmic scale from `low`, about five times what three 20 s recordings resolve at nominal
noise, to `high`; a faint one from a fifth of `low` up to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

FAINTEST = 0.2
"""Share of `low` at which faint sizes begin."""


@dataclass(frozen=True)
class Size:
    """A parameter whose distance from `neutral` is the size of the effect."""

    low: float
    high: float
    neutral: float = 0.0
    signs: tuple[int, ...] = (1,)
    step: float = 0.0
    """Grid of the values; 0 for none."""

    def __call__(self, rng: np.random.Generator, faint: bool) -> float:
        """Draw a value."""
        low, high = (FAINTEST * self.low, self.low) if faint else (self.low, self.high)
        size = float(np.exp(rng.uniform(np.log(low), np.log(high)))) * int(rng.choice(self.signs))
        return self.neutral + (self.step * round(size / self.step) if self.step else size)


Draw = Callable[[np.random.Generator, bool], Any]


def shape(low: float, high: float) -> Draw:
    """A parameter other than the size, drawn evenly on a logarithmic scale."""
    return lambda rng, faint: float(np.exp(rng.uniform(np.log(low), np.log(high))))


def pick(*words: str) -> Draw:
    """A choice among words."""
    return lambda rng, faint: str(rng.choice(words))


def values(entry: Mapping[str, Any], rng: np.random.Generator, *, faint: bool = False) -> dict[str, Any]:
    """Parameters of one effect, as the emulator takes them."""
    return {key: one(rng, faint) if callable(one) else one for key, one in entry.items()}


def _signed(low: float, high: float) -> Size:
    return Size(low, high, signs=(-1, 1))


def _ratio(low: float, high: float) -> Size:
    return Size(low, high, neutral=1.0, signs=(-1, 1))


_CHAMBER, _CELL, _EDGE = pick("a", "b"), pick("hydraulic_force", "load_force"), pick("pa", "at", "pb", "bt")
SINGLES: dict[str, dict[str, Any]] = {
    "friction_coulomb": {"force": Size(2.0, 20.0)},
    "friction_coulomb/directional": {"force_positive": Size(6.0, 15.0), "force_negative": Size(2.0, 5.0)},
    "friction_viscous": {"coefficient": Size(8.0, 60.0)},
    "friction_stribeck": {"breakaway_force": Size(4.0, 15.0), "velocity": shape(0.01, 0.03)},
    "leakage_internal": {"coefficient": Size(1e-14, 3e-13)},
    "leakage_external": {"coefficient": Size(1e-14, 1e-13), "chamber": _CHAMBER},
    "valve_deadband": {"half_width": Size(5e-5, 1e-3)},
    "valve_underlap": {"half_width": Size(3e-5, 6e-4)},
    "valve_edge": {"overlap": _signed(5e-5, 6e-4), "edge": _EDGE},
    "valve_edge/share": {"ratio": Size(0.05, 0.4, neutral=1.0, signs=(-1,)), "edge": _EDGE},
    "valve_lag": {"bandwidth": shape(60.0, 180.0), "damping": shape(0.6, 1.0)},
    "transport_delay": {"time": Size(3e-4, 1.5e-3, step=25e-6)},  # the emulator's own step
    "valve_offset": {"current": _signed(3e-5, 5e-4)},
    "valve_gain": {"ratio": _ratio(0.03, 0.15)},
    "valve_gain_asymmetry": {"ratio": _ratio(0.03, 0.2)},
    "valve_null_leakage": {"coefficient": Size(5e-11, 1e-9), "width": shape(3e-4, 2e-3)},
    "supply_droop": {"resistance": Size(1e10, 1e11), "time_constant": shape(0.02, 0.3)},
    "return_line": {"resistance": Size(1e10, 2e11), "time_constant": shape(0.003, 0.1)},
    "supply_pump": {"flow_limit": shape(4e-6, 1.2e-5), "volume": shape(3e-4, 1e-3)},
    "oil_drift": {"rate": _signed(2e-3, 1.2e-2)},
    "bulk_modulus": {"ratio": Size(0.05, 0.3, neutral=1.0, signs=(-1,))},
    "entrained_air": {"volume_fraction": Size(2e-3, 2e-2)},
    "load_cell_gain": {"ratio": _ratio(0.02, 0.1), "cell": _CELL},
    "load_cell_bias": {"force": _signed(2.0, 20.0), "cell": _CELL},
    "pressure_sensor_bias": {"pressure": _signed(1.5e4, 2e5), "chamber": _CHAMBER},
    "spring_hardening": {"coefficient": Size(2e6, 2e7)},
    "backlash": {"width": Size(1e-4, 1e-3)},
    "moving_mass": {"mass": Size(0.2, 1.0)},
    "valve_gain_drift": {"rate": _signed(2e-3, 8e-3)},
    "end_cushion": {"stiffness": Size(2e3, 2e4), "position": shape(0.043, 0.048)},
    "force_offset": {"force": _signed(3.0, 30.0)},
    "sensor_lag": {"bandwidth": shape(30.0, 90.0), "sensor": pick("hydraulic_force", "pressure_a", "pressure_b")},
}
"""Named causes, in the form that the table has."""

VALUES: dict[str, dict[str, Any]] = {
    "spring_stiffness": {"ratio": _ratio(0.015, 0.15)},
    "supply_pressure": {"ratio": _ratio(0.02, 0.1)},
    "piston_area": {"ratio": _ratio(0.02, 0.08)},
    "area_ratio": {"ratio": _ratio(0.02, 0.08)},
    "dead_volume": {"ratio": _ratio(0.03, 0.2), "chamber": _CHAMBER},
    "tank_pressure": {"pressure": Size(5e4, 5e5)},
    "spring_rest": {"position": Size(1e-4, 1e-3, neutral=0.04, signs=(-1, 1))},
}
"""Wrong numbers in the bench file."""

FORMS: dict[str, dict[str, Any]] = {
    "friction_coulomb/lugre": {"force": Size(4.0, 20.0), "form": "lugre"},
    "friction_coulomb/smooth": {"force": Size(4.0, 20.0), "form": "smooth"},
    "valve_lag/first_order": {"bandwidth": shape(60.0, 180.0), "damping": 0.8, "order": 1},
    "valve_lag/rate_limited": {"bandwidth": shape(80.0, 180.0), "damping": 0.8, "rate_limit": shape(2.0, 6.0)},
    "valve_deadband/soft": {"half_width": Size(1e-4, 1e-3), "form": "soft"},
    "valve_deadband/lopsided": {"half_width": Size(1e-4, 5e-4), "half_width_negative": Size(1e-4, 5e-4)},
    "return_line/orifice": {"orifice": shape(8e-9, 3e-8), "time_constant": shape(0.004, 0.05), "form": "orifice"},
    "entrained_air/isothermal": {"volume_fraction": Size(3e-3, 2e-2), "form": "isothermal"},
    "valve_null_leakage/hyperbolic": {
        "coefficient": Size(1e-10, 1e-9), "width": shape(3e-4, 2e-3), "form": "hyperbolic"},
    "leakage_internal/orifice": {"coefficient": Size(2e-14, 3e-13), "form": "orifice"},
    "backlash/play": {"width": Size(1e-4, 1e-3), "form": "play"},
    "end_cushion/quadratic": {"stiffness": Size(4e3, 2e4), "position": 0.044, "form": "quadratic"},
    "sensor_lag/damping": {"bandwidth": shape(15.0, 22.0), "sensor": "load_force", "damping": 0.5},
}  # fmt: skip
"""The same causes in another form."""

OUTSIDE: dict[str, dict[str, Any]] = {
    "friction_rib": {"force": Size(4.0, 15.0)},
    "friction_pressure": {"coefficient": Size(1e-6, 4e-6)},
    "spring_hysteresis": {"force": Size(6.0, 20.0)},
    "valve_temperature": {"change": _signed(0.03, 0.15)},
    "cell_crosstalk": {"coefficient": _signed(1e-6, 4e-6), "chamber": _CHAMBER, "cell": _CELL},
    "load_hum": {"amplitude": Size(3.0, 15.0)},
    "load_walk": {"force": Size(3.0, 15.0)},
    "wall_flexibility": {"compliance": Size(1e-14, 1e-13)},
    "supply_ripple": {"amplitude": Size(1e5, 5e5)},
}
"""Causes that the diagnosis has no name for."""
FITTED, HELD = ("run1", "run2", "run3"), "held"
"""Names of a case's recordings."""
SECONDS = 20.0
"""Length of a recording [s]."""
PARTS: dict[str, int] = {
    "single": 70, "faint": 14, "value": 16, "form": 16, "pair": 24, "triple": 12, "clean": 60, "outside": 12,
}  # fmt: skip
"""Number of cases of each kind, of 224 in total."""

Schedule = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One bench, its concealed causes, and its excitation."""

    name: str
    """case-000 and so on: says nothing about what is concealed."""
    kind: str
    """A key of `PARTS`."""
    label: str
    """The concealed causes, in a word."""
    effects: Mapping[str, Any] = field(default_factory=dict)
    """Named causes, as under `effects` of the emulator's truth file."""
    outside: Mapping[str, Any] = field(default_factory=dict)
    """Unnamed causes, as under `outside` there."""
    size: tuple[str, float] | None = None
    """Size parameter of a single cause, and its distance from the neutral value."""
    noise: float = 1.0
    """Scale of the sensors' noise."""
    seed: int = 0
    """Seed of noise and random forces."""
    schedules: Mapping[str, Schedule] = field(default_factory=dict)
    """Reference and gains by recording; the held-out one is of another class than those that are fitted."""

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Case:
        """A case from plain data."""
        size = data["size"]
        return cls(**{**data, "size": None if size is None else (size[0], size[1])})


def missing(folder: Path) -> list[str]:
    """Recordings of the case in a folder that are not there, or not whole."""
    return [name for name in (*FITTED, HELD) if not (folder / name / "metadata.yaml").exists()]


def draw(count: int, seed: int) -> list[Case]:
    """Draw `count` cases in the proportions of `PARTS`, by largest remainders, in random order."""
    exact = {kind: count * part / sum(PARTS.values()) for kind, part in PARTS.items()}
    whole = {kind: int(share) for kind, share in exact.items()}
    for kind in sorted(exact, key=lambda one: whole[one] - exact[one])[: count - sum(whole.values())]:
        whole[kind] += 1
    return draw_parts(whole, seed)


def draw_parts(parts: Mapping[str, int], seed: int) -> list[Case]:
    """Draw the number of cases of each kind that `parts` gives, in random order."""
    rng = np.random.default_rng(seed)
    drawn = [case for kind, count in parts.items() for case in _of_kind(kind, count, rng)]
    order = rng.permutation(len(drawn))
    return [replace(drawn[at], name=f"case-{k:03d}") for k, at in enumerate(order)]


def _of_kind(kind: str, count: int, rng: np.random.Generator) -> Iterator[Case]:
    names = _turns(kind, count, rng)
    for k in range(count):
        if kind == "clean":
            noise = float(np.exp(rng.uniform(np.log(0.1), np.log(4.0))))
            case = Case(name="", kind=kind, label="nothing", noise=noise)
        elif kind in _SIZES:
            case = _combined(kind, rng)
        else:
            case = _one(kind, names[k], rng)
        yield replace(case, seed=int(rng.integers(1, 10**6)), schedules=_schedules(rng))


_FADING = {name: entry for name, entry in SINGLES.items() if any(isinstance(one, Size) for one in entry.values())}
"""Single causes that vanish with their size, and can therefore be faint."""
_TABLES = {"single": SINGLES, "faint": _FADING, "value": VALUES, "form": FORMS, "outside": OUTSIDE}
_SIZES = {"pair": 2, "triple": 3}


def _turns(kind: str, count: int, rng: np.random.Generator) -> list[str]:
    """Names from the kind's table in random order, each once before any repeats."""
    names = list(_TABLES.get(kind, ()))
    turns: list[str] = []
    while names and len(turns) < count:
        turns += [names[at] for at in rng.permutation(len(names))]
    return turns


def _one(kind: str, name: str, rng: np.random.Generator) -> Case:
    entry = _TABLES[kind][name]
    drawn = values(entry, rng, faint=kind == "faint")
    where = "outside" if kind == "outside" else "effects"
    concealed: dict[str, Any] = {where: {_id(name): drawn}}
    sizes = ((key, abs(drawn[key] - one.neutral)) for key, one in entry.items() if isinstance(one, Size))
    return Case(name="", kind=kind, label=name, size=next(sizes, None), noise=_noise(rng), **concealed)


def _combined(kind: str, rng: np.random.Generator) -> Case:
    tables = {**SINGLES, **VALUES}
    while True:
        chosen = [str(name) for name in rng.choice(list(tables), _SIZES[kind], replace=False)]
        if len({_id(name) for name in chosen}) == len(chosen):
            break
    effects = {_id(name): values(tables[name], rng) for name in chosen}
    return Case(name="", kind=kind, label=" + ".join(chosen), effects=effects, noise=_noise(rng))


def _id(name: str) -> str:
    return name.split("/")[0]


def _noise(rng: np.random.Generator) -> float:
    return float(rng.choice([0.5, 1.0, 2.0]))


_FASTEST = {"sine": 2.0, "multisine": 0.8, "smooth_step": 1.2}
"""Highest frequency [Hz] by class of reference."""


def _schedules(rng: np.random.Generator) -> dict[str, Schedule]:
    """Four runs under different stable gains: two classes of reference are fitted, the third is held out."""
    first, second, held = (str(name) for name in rng.permutation(list(_FASTEST)))
    classes = [first, second, str(rng.choice([first, second])), held]
    return {
        name: {
            "seconds": SECONDS, "waveform": waveform,
            "amplitude": float(rng.uniform(200.0, 300.0)), "offset": float(rng.uniform(-40.0, 40.0)),
            "frequency": float(rng.uniform(0.5 * _FASTEST[waveform], _FASTEST[waveform])), "phase": 0.0,
            "kp": float(rng.uniform(30.0, 90.0)), "ki": float(rng.uniform(5.0, 15.0)),
        }
        for name, waveform in zip((*FITTED, HELD), classes, strict=True)
    }  # fmt: skip
