# SPDX-License-Identifier: Apache-2.0
"""A law that was found on several benches becomes an effect; what is no such law is refused."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_core.errors import UserError
from hydro_diagnosis.cli import run
from hydro_diagnosis.growing import agreements, law_estimates
from hydro_sim.model import grammar
from hydro_sim.model.laws import Law
from tests.checks import each, ran

DRAG = ("motion", "quadratic drag")
Numbers = Mapping[str, tuple[float, float, float]]
"""Value and ends of the interval, by a law's parameter."""


def closure(law: Law, numbers: Numbers) -> dict[str, Any]:
    """An entry of `closures` as `closure.admission` writes it."""
    units = {"coefficient": law.unit, **{one.name: one.unit for one in law.numbers}}
    terms = {name: {"value": value, "ci95": [low, high], "unit": units[name]}
             for name, (value, low, high) in numbers.items()}  # fmt: skip
    further = "".join(f", {one.name} = {numbers[one.name][0]:.4g} {one.unit}" for one in law.numbers)
    expression = f"{numbers['coefficient'][0]:.4g} {law.unit} * {law.text}{further}"
    return {"equation": law.equation, "form": "law", "expression": expression, "terms": terms, "range": None,
            "sentence": law.sentence, "share_closed": 1.0, "share_by_form": {}}  # fmt: skip


def report(folder: Path, *closures: Mapping[str, Any]) -> str:
    folder.mkdir(parents=True)
    recordings = [{"name": folder.name, "begin": None}]
    content = {"verdict": "modelled" if closures else "explained", "closures": closures, "recordings": recordings}
    (folder / "report.json").write_text(json.dumps(content))
    return str(folder)


def law(equation: str, form: str) -> Law:
    found = grammar.FORMS[equation, form]
    assert isinstance(found, Law)
    return found


def around(value: float) -> tuple[float, float, float]:
    low, high = sorted((0.99 * value, 1.01 * value))
    return value, low, high


def dragged(folder: Path, coefficient: float) -> str:
    return report(folder, closure(law(*DRAG), {"coefficient": around(coefficient)}))


EVERY = (*grammar.LAWS[::3], *grammar.ROUNDED[::3])
SMOOTH = {"equation": "load", "form": "smooth", "expression": "f(position)", "terms": {}, "range": [0.0, 1.0],
          "sentence": "A smooth function.", "share_closed": 1.0, "share_by_form": {}}  # fmt: skip


def test_a_report_says_which_law_it_holds(tmp_path: Path) -> None:
    def check(number_and_law: tuple[int, Law]) -> None:
        number, law = number_and_law
        numbers = {name: around(0.1 * (k + 1)) for k, name in enumerate(law.names)}
        folders = [report(tmp_path / str(number) / name, closure(law, numbers)) for name in "ab"]
        assert [one.law for one in law_estimates(folders)] == [law, law]

    each(enumerate(EVERY), check, lambda case: f"{case[1].equation} {case[1].form}")


def test_one_value_fits_benches_whose_intervals_overlap_and_not_others(tmp_path: Path) -> None:
    alike = law_estimates([dragged(tmp_path / "a", 880.0), dragged(tmp_path / "b", 884.0)])
    (agreed,) = agreements(alike)
    deviation = 880.0 * 0.01 / 1.959964
    weights = np.array([1.0, (880.0 / 884.0) ** 2]) / deviation**2
    assert agreed.common == pytest.approx(weights @ [880.0, 884.0] / weights.sum(), rel=1e-6)
    assert agreed.consistent and "one value fits all benches" in agreed.sentence
    (apart,) = agreements(law_estimates([dragged(tmp_path / "c", 500.0), dragged(tmp_path / "d", 884.0)]))
    assert not apart.consistent and "each bench has its own value" in apart.sentence


REFUSED: tuple[tuple[list[str], str], ...] = (
    (["a"], "one report is one bench: a law must have been found on 2"),
    (["a", "a"], "are one diagnosis"),
    (["a", "clean"], "clean has no closure"),
    (["a", "smooth"], "smooth function in load, not a law"),
    (["a", "other"], "the reports hold different laws: .*quadratic drag.*cubic drag"),
    (["both", "two"], "several laws in common: choose by --law one of 'quadratic drag', 'cubic drag'"),
    (["both", "two", "--law", "root drag"], "do not share a law 'root drag'"),
    (["a", "no_report"], "is not a report.json of a diagnosis"),
    (["a", "two", "--id", "moving_mass"], "an effect of this id exists"),
    (["a", "two", "--id", "closure"], "an effect of this id exists"),
    (["a", "two", "--id", "Port Drag"], "lower-case words joined by _"),
)


def test_what_is_no_law_of_several_benches_is_refused_in_a_sentence(tmp_path: Path) -> None:
    cubic = closure(law("motion", "cubic drag"), {"coefficient": around(2e3)})
    drag = closure(law(*DRAG), {"coefficient": around(880.0)})
    for name, closures in {"a": [drag], "clean": [], "smooth": [SMOOTH], "other": [cubic], "both": [drag, cubic],
                           "two": [drag, cubic]}.items():  # fmt: skip
        report(tmp_path / name, *closures)
    (tmp_path / "no_report").mkdir()
    (tmp_path / "no_report" / "report.json").write_text("[]")
    for words, sentence in REFUSED:
        given = [str(tmp_path / word) if (tmp_path / word).exists() else word for word in words]
        options = given if "--id" in given else [*given, "--id", "port_drag"]
        with pytest.raises(UserError, match=sentence):
            run(["--grow", *options, "--out", str(tmp_path / "out")])
        assert not (tmp_path / "out").exists()


GROWN = [
    (DRAG, {"coefficient": 880.0}),
    (("actuation", "quadratic opening"), {"coefficient": -4.6}),
    (("load", "hysteresis"), {"coefficient": 7.0, "path": 2e-3}),
    (("pressure_a", "creeping volume"), {"coefficient": 1.3e-13, "time": 0.15}),
    (("sensor", "even quadratic reading of hydraulic_force"), {"coefficient": 6e-5}),
]


def grow(folder: Path, which: tuple[str, str], values: Mapping[str, float]) -> Path:
    """Grow `grown_one` from two reports, into a folder of its own."""
    reports = []
    for name, share in (("a", 1.0), ("b", 1.002)):
        numbers = {one: around(share * value) for one, value in values.items()}
        reports.append(report(folder / name, closure(law(*which), numbers)))
    assert run(["--grow", *reports, "--id", "grown_one", "--out", str(folder / "out")]) == 0
    return folder / "out"


FOUND_AGAIN = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from hydro_core.signals import Waveform
from hydro_diagnosis import diagnose
from hydro_sim.model.bench import Bench
from tests.segments import driven, frame, record

def truth(values):
    return replace(Bench.nominal(), effects=({"id": "grown_one", "parameters": values},))

values, folder, files = json.loads(sys.argv[1]), Path(sys.argv[2]), []
nothing = truth({**values, "coefficient": 0.0})
still, plain = (driven(one)[0].channels["load_force"] for one in (nothing, Bench.nominal()))
np.testing.assert_allclose(still, plain, rtol=1e-9, atol=1e-6)
for seed, waveform in enumerate((Waveform.MULTISINE, Waveform.SINE, Waveform.SMOOTH_STEP), 1):
    files.append(folder / f"run{seed}.csv")
    frame(record(truth(values), seed, waveform=waveform)).to_csv(files[-1], index=False)
report = diagnose(files[:2], holdout=files[2:]).report
(found,) = report.effects
print(json.dumps([report.verdict, found.id, {name: one.value for name, one in found.parameters.items()}]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "values"), [GROWN[0], *(pytest.param(*one, marks=pytest.mark.study) for one in GROWN[1:])]
)
def test_a_grown_effect_of_size_0_is_nothing_and_else_is_found_again(
    which: tuple[str, str], values: dict[str, float], tmp_path: Path
) -> None:
    folder = grow(tmp_path, which, values)
    place: dict[str, Any] = {"cwd": Path(__file__).parents[3], "env": {**os.environ, "HYDRO_EFFECTS": str(folder)}}
    done = ran(sys.executable, "-c", FOUND_AGAIN, json.dumps(values), tmp_path, **place)
    assert done.returncode == 0, done.stderr
    verdict, name, found = json.loads(done.stdout.splitlines()[-1])
    assert (verdict, name) == ("explained", "grown_one")
    assert found == pytest.approx(values, rel=0.1)


STARTED = """
import sys
from hydro_core.process.start import main_of
sys.exit(main_of.hydro_diagnosis.cli())
"""


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("law: {", "ParserError"),
        ("law: {equation: motion, form: quadratic drag}\n", "parameters"),
        ("law: {equation: motion, form: table over velocity}\nparameters: {}\n", "a table of numbers is not an effect"),
    ],
)
def test_a_grown_effect_that_cannot_be_read_ends_in_one_sentence(tmp_path: Path, source: str, why: str) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_text(source)
    environment = {**os.environ, "HYDRO_EFFECTS": str(tmp_path)}
    done = ran(sys.executable, "-c", STARTED, "nothing.csv", "--out", tmp_path / "report", env=environment)
    assert done.returncode == 2
    (sentence,) = done.stderr.strip().splitlines()
    assert str(broken) in sentence
    assert why in sentence
    assert sentence.endswith("fix the file or remove it")
