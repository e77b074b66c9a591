# SPDX-License-Identifier: Apache-2.0
"""Effects and closures: simulation and diagnosis, written apart, mean the same; a bench file carries them."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_bridge.files import bench_file
from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.report.corrected_bench import claims_of, corrected_bench
from hydro_sim.model import grammar, tables
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import CATALOGUE, label
from hydro_sim.model.laws import Law, Signals
from hydro_sim.model.tables import Table
from tests.checks import each
from tests.segments import apart, driven

BENCH = Bench.nominal()
EFFECTS = [effect.adapted(BENCH) for effect in LIBRARY]
TOLERANCE = 2e-4
"""RMS of the difference after up to 40 ms, over the signal's range."""


def claims_with(effect: Effect) -> list[Claim]:
    """The effect at its first guess, after what it needs."""
    needed = [next(one for one in EFFECTS if one.id == name) for name in effect.needs]
    return [Claim(one, {entry.name: entry.probes[0] for entry in one.parameters}) for one in (*needed, effect)]


def test_every_value_that_a_diagnosis_may_report_is_simulated() -> None:
    for effect in EFFECTS:
        entry = Claim(effect, {one.name: one.probes[0] for one in effect.parameters}).to_mapping()
        simulated = {quantity.name: quantity for quantity in CATALOGUE[label(entry)].parameters}
        for one in effect.parameters:
            assert simulated[one.name].low <= one.low and one.high <= simulated[one.name].high, effect.label


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.label)
def test_simulation_and_diagnosis_mean_the_same_effect(effect: Effect) -> None:
    claims = claims_with(effect)
    segment, states = driven(replace(BENCH, effects=tuple(claim.to_mapping() for claim in claims)))
    with_it, without = apart(segment, states, claims), apart(segment, states, claims[:-1])
    if effect.label == "backlash:play":  # the diagnosis takes its readings from the middle of the gap in each window
        assert with_it.pop("load_force") < 0.5 * without.pop("load_force")
    assert max(with_it.values()) < TOLERANCE
    assert max(without[name] / with_it[name] for name in with_it) > 20.0


LIMITS = {
    "position": (0.02, 0.06), "velocity": (-0.3, 0.3), "pressure_difference": (-5e6, 5e6), "current": (-0.02, 0.02),
    "force": (-400.0, 400.0), "pressure_a": (3e6, 9e6), "pressure_b": (3e6, 9e6),
    "past_motion": (0.0, 0.02), "past_opening": (0.0, 1e-3), "elapsed": (0.0, 0.25),
}  # fmt: skip
SHARES = {"saturation": -1.0, "curve": -0.1, "gain, as the coil": -0.01, "null by opening and": -0.5}
"""Of the typical size: a valve that opens further makes this loop swing."""


def covering(terms: Sequence[Any], words: Callable[[Any], set[tuple[str, ...]]]) -> list[Any]:
    """Those of the terms that say something for the first time."""
    seen: set[tuple[str, ...]] = set()
    chosen = []
    for term in terms:
        if new := words(term) - seen:
            seen |= new
            chosen.append(term)
    return chosen


def parts(law: Law) -> set[tuple[str, ...]]:
    """Carrier and modulation of a composition, with the equation in which they stand."""
    carrier, _, modulation = law.form.partition(", ")
    place = law.where if law.where.startswith("load") else law.equation[:8] + law.where
    place = "" if law.where.startswith("h") else place
    return {(place, carrier, ""), (place, "", modulation)}


def ways(table: Table) -> set[tuple[str, ...]]:
    """Variable and factor of a table, with the equation in which they stand."""
    place = "of the load" if table.where == "load_force" else table.equation[:8]
    return {(place, table.variable), (place, table.factor.text if table.factor else "")}


WIDE = [next(law for law in grammar.ROUNDED if law.equation == equation and law.element is None)
        for equation in ("motion", "load", "pressure", "pressure_a")]  # fmt: skip
MIXED = sorted(grammar.COMPOSITIONS, key=lambda one: zlib.crc32(one.form.encode()))
TERMS: tuple[Law | Table, ...] = (
    *grammar.LAWS, *covering(MIXED, parts), *WIDE, *covering(grammar.TABLES, ways),
)  # fmt: skip


def claimed(law: Law | Table) -> Claim:
    """A term at its typical size; a table goes up and down."""
    effect = closure(law, BENCH, LIMITS[law.variable] if isinstance(law, Table) else (0.0, 1.0))
    amplitudes = [one for one in effect.parameters if one.smallest > 0.0]
    share = next((one for form, one in SHARES.items() if law.form.startswith(form)), 1.0)
    sizes = {one.name: share * one.probes[0] * (-0.5) ** (k % 2) for k, one in enumerate(amplitudes)}
    starts = effect.nothing() * 2
    placed = isinstance(law, Law) and any(number.over for number in law.numbers)
    below = "below a pressure" in law.form or law.form.endswith("below a limit")
    start = starts[-2 if below else 1 if placed else -2]  # a threshold that this motion passes
    passed = {"threshold": 9.5e6} if law.form.endswith(("a pressure of B", "of pressure_b, below a limit")) else {}
    return Claim(effect, {**start, **passed, **sizes})


def entry(claim: Claim) -> dict[str, object]:
    assert isinstance(claim.effect, Closure)
    return claim.effect.to_closure(claim.values)


def title(law: Law | Table) -> str:
    return f"{law.equation} {law.form}"


@pytest.mark.parametrize("every", [14, pytest.param(1, marks=pytest.mark.study)])
def test_simulation_and_diagnosis_mean_the_same_term(every: int) -> None:
    each(TERMS[::every], same_in_simulation_and_diagnosis, title)


def same_in_simulation_and_diagnosis(law: Law | Table) -> None:
    claim = claimed(law)
    amplitude = 560.0 if "from A to B" in law.form or "driven out" in law.form else 280.0  # p_a is mostly below p_b
    run = driven(replace(BENCH, closures=(entry(claim),)), amplitude)
    with_it, without = apart(*run, [claim]), apart(*run, [])
    named = law in (*grammar.LAWS, *grammar.TABLES) and not law.form.startswith("snubber")
    assert max(with_it.values()) < (2e-5 if named else 1e-4)  # some others turn round within a sample
    assert max(without[name] / with_it[name] for name in with_it) > 100.0


def test_closures_survive_the_corrected_bench_and_its_file(tmp_path: Path) -> None:
    claims = [claimed(grammar.ALL["motion", "quadratic drag"]), claimed(grammar.ALL["load", "table over position"])]
    path = tmp_path / "corrected.yaml"
    path.write_text(yaml.safe_dump(corrected_bench(BENCH, claims).to_mapping()))
    back = claims_of(Bench.load(path))
    assert [(one.effect.label, dict(one.values)) for one in back] == [
        (one.effect.label, dict(one.values)) for one in claims
    ]
    assert isinstance(back[1].effect, Closure)
    assert back[1].effect.limits == LIMITS["position"]
    assert Bench.load(path).digest == bench_file.digest(bench_file.read_numbers(path)) != BENCH.digest


def test_a_table_that_cannot_be_evaluated_is_refused() -> None:
    made = entry(claimed(grammar.ALL["load", "table over position"]))
    for change in ({"low": 0.2, "high": 0.2}, {"value_3": 1e9}, {"value_3": float("nan")}):
        with pytest.raises(ValueError, match=r"low must be below high|value_3"):
            replace(BENCH, closures=({**made, "parameters": {**made["parameters"], **change}},))  # type: ignore[dict-item]


def test_a_closure_is_no_effect() -> None:
    made = entry(claimed(grammar.ALL["motion", "quadratic drag"]))
    with pytest.raises(ValueError, match="closures stand under 'closures'"):
        replace(BENCH, effects=({"id": "closure", **made},))


def test_a_table_is_constant_beyond_what_was_seen() -> None:
    table = grammar.ALL["motion", "table over velocity"]
    numbers = [-0.1, 0.2, *np.arange(tables.KNOTS, dtype=float)]
    inside = table.value(Signals(velocity=np.array([-0.1, 0.05, 0.2])), BENCH, numbers)
    beyond = table.value(Signals(velocity=np.array([-9.0, 9.0])), BENCH, numbers)
    np.testing.assert_allclose(inside, [1.0, 0.5 * (tables.KNOTS - 1), tables.KNOTS - 2])
    np.testing.assert_allclose(beyond, [1.0, tables.KNOTS - 2])


@pytest.mark.parametrize(
    ("closures", "sentence"),
    [
        ("drag", "'closures' is a list of mappings, each with an 'equation', 'form', 'parameters'"),
        (
            [{"equation": "motion", "form": "drag", "parameters": {}}],
            "effect 'closure equation=motion form=drag' is not",
        ),
        ([{"equation": "motion", "form": "quadratic drag", "parameters": {}}], "lacks its parameter coefficient"),
        ([entry(claimed(grammar.LAWS[0]))] * 7, "7 closures are more than the 6"),
    ],
)
def test_closures_that_cannot_be_simulated_are_refused(closures: object, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence.replace("[", r"\[")):
        Bench.from_mapping({**BENCH.to_mapping(), "closures": closures})
