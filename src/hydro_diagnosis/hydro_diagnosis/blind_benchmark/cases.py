# SPDX-License-Identifier: Apache-2.0
"""Sealed cases, drawn from one seed: benches with up to three concealed causes, and their excitation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from hydro_diagnosis.blind_benchmark.magnitudes import FORMS, OUTSIDE, SINGLES, VALUES, Size, size_of, values

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


def draw(count: int, seed: int) -> list[Case]:
    """Draw `count` cases in the proportions of `PARTS`, in random order."""
    return draw_parts(shares(count), seed)


def draw_parts(parts: Mapping[str, int], seed: int) -> list[Case]:
    """Draw the number of cases of each kind that `parts` gives, in random order."""
    rng = np.random.default_rng(seed)
    drawn = [case for kind, count in parts.items() for case in _of_kind(kind, count, rng)]
    order = rng.permutation(len(drawn))
    return [replace(drawn[at], name=f"case-{k:03d}") for k, at in enumerate(order)]


def shares(count: int) -> dict[str, int]:
    """Number of cases of each kind, `count` in total, by largest remainders of the proportions of `PARTS`."""
    exact = {kind: count * part / sum(PARTS.values()) for kind, part in PARTS.items()}
    whole = {kind: int(share) for kind, share in exact.items()}
    for kind in sorted(exact, key=lambda one: whole[one] - exact[one])[: count - sum(whole.values())]:
        whole[kind] += 1
    return whole


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
    return Case(name="", kind=kind, label=name, size=size_of(entry, drawn), noise=_noise(rng), **concealed)


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


def _schedules(rng: np.random.Generator) -> dict[str, Schedule]:
    """Four runs under different stable gains: two classes of reference are fitted, the third is held out."""
    first, second, held = (str(name) for name in rng.permutation(list(_FASTEST)))
    classes = [first, second, str(rng.choice([first, second])), held]
    return {name: _schedule(one, rng) for name, one in zip((*FITTED, HELD), classes, strict=True)}


_FASTEST = {"sine": 2.0, "multisine": 0.8, "smooth_step": 1.2}
"""Highest frequency [Hz] by class of reference."""


def _schedule(waveform: str, rng: np.random.Generator) -> Schedule:
    fastest = _FASTEST[waveform]
    return {
        "seconds": SECONDS,
        "waveform": waveform,
        "amplitude": float(rng.uniform(200.0, 300.0)),
        "offset": float(rng.uniform(-40.0, 40.0)),
        "frequency": float(rng.uniform(0.5 * fastest, fastest)),
        "phase": 0.0,
        "kp": float(rng.uniform(30.0, 90.0)),
        "ki": float(rng.uniform(5.0, 15.0)),
    }
