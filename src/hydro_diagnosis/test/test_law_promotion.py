# SPDX-License-Identifier: Apache-2.0
"""A law that was found on several benches becomes an effect; what is no such law is refused."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hydro_core.errors import UserError
from hydro_diagnosis.cli import run
from hydro_diagnosis.closure.validation import closure_reports
from hydro_diagnosis.effects import EffectHypothesis
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.law_promotion import law_estimates, parameter_agreements
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import Law
from hydro_sim.model.tables import Table
from tests.checks import each, ran

DRAG = grammar.FORMS["motion", "quadratic drag"]


def entry(law: Law | Table, **values: float) -> dict[str, Any]:
    """What a diagnosis writes about a term, each number within 1 %; those that are not given are 1."""
    effect = closure(law, Bench.nominal())
    sizes = {one.name: values.get(one.name, 1.0) for one in effect.parameters}
    bounds = [Interval(size, *sorted((0.99 * size, 1.01 * size)), identifiable=True) for size in sizes.values()]
    fit: Any = SimpleNamespace(claims=[EffectHypothesis(effect, sizes)])
    (found,) = closure_reports(fit, bounds, share=1.0)
    return asdict(found)


def report(folder: Path, *closures: dict[str, Any]) -> str:
    folder.mkdir(parents=True)
    recordings = [{"name": folder.name, "begin": None}]
    content = {"verdict": "modelled" if closures else "explained", "closures": closures, "recordings": recordings}
    (folder / "report.json").write_text(json.dumps(content))
    return str(folder)


def test_a_report_says_which_law_it_holds(tmp_path: Path) -> None:
    def check(case: tuple[int, Law]) -> None:
        number, law = case
        folders = [report(tmp_path / str(number) / name, entry(law)) for name in "ab"]
        assert [one.law for one in law_estimates(folders)] == [law, law]

    laws = (*grammar.LAWS[::3], *grammar.LAWS_WITH_REVERSAL_VELOCITY[::3])
    each(enumerate(laws), check, lambda case: f"{case[1].equation} {case[1].form}")


def test_one_value_fits_benches_whose_intervals_overlap_and_not_others(tmp_path: Path) -> None:
    a, b, c = (report(tmp_path / str(size), entry(DRAG, coefficient=size)) for size in (880.0, 884.0, 500.0))
    (agreed,) = parameter_agreements(law_estimates([a, b]))
    weights = np.array([1.0, (880.0 / 884.0) ** 2]) / (880.0 * 0.01 / 1.959964) ** 2
    assert agreed.common == pytest.approx(weights @ [880.0, 884.0] / weights.sum(), rel=1e-6)
    assert agreed.consistent and "one value fits all benches" in agreed.sentence
    (apart,) = parameter_agreements(law_estimates([c, b]))
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
    drag, cubic, smooth = map(entry, (DRAG, grammar.FORMS["motion", "cubic drag"],
                                      grammar.FORMS["load", "table over position"]))  # fmt: skip
    for name, closures in {"a": [drag], "clean": [], "smooth": [smooth], "other": [cubic], "both": [drag, cubic],
                           "two": [drag, cubic], "no_report": []}.items():  # fmt: skip
        report(tmp_path / name, *closures)
    (tmp_path / "no_report" / "report.json").write_text("[]")
    for words, sentence in REFUSED:
        given = [str(tmp_path / word) if (tmp_path / word).exists() else word for word in words]
        options = given if "--id" in given else [*given, "--id", "port_drag"]
        with pytest.raises(UserError, match=sentence):
            run(["--grow", *options, "--out", str(tmp_path / "out")])
        assert not (tmp_path / "out").exists()


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
GROWN = [
    ("motion", "quadratic drag", {"coefficient": 880.0}),
    ("actuation", "quadratic opening", {"coefficient": -4.6}),
    ("load", "hysteresis", {"coefficient": 7.0, "path": 2e-3}),
    ("pressure_a", "creeping volume", {"coefficient": 1.3e-13, "time": 0.15}),
    ("sensor", "even quadratic reading of hydraulic_force", {"coefficient": 6e-5}),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equation", "form", "values"), [GROWN[0], *(pytest.param(*one, marks=pytest.mark.study) for one in GROWN[1:])]
)
def test_a_grown_effect_of_size_0_is_nothing_and_else_is_found_again(
    equation: str, form: str, values: dict[str, float], tmp_path: Path
) -> None:
    law, out = grammar.FORMS[equation, form], tmp_path / "out"
    twice = (values, {name: 1.002 * value for name, value in values.items()})
    reports = [report(tmp_path / str(k), entry(law, **sizes)) for k, sizes in enumerate(twice)]
    assert run(["--grow", *reports, "--id", "grown_one", "--out", str(out)]) == 0
    place: dict[str, Any] = {"cwd": Path(__file__).parents[3], "env": {**os.environ, "HYDRO_EFFECTS": str(out)}}
    done = ran(sys.executable, "-c", FOUND_AGAIN, json.dumps(values), tmp_path, **place)
    assert done.returncode == 0, done.stderr
    verdict, name, found = json.loads(done.stdout.splitlines()[-1])
    assert (verdict, name) == ("explained", "grown_one")
    assert found == pytest.approx(values, rel=0.1, abs=0.0)


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
    started = "import sys\nfrom hydro_core.process.startup import main_of\nsys.exit(main_of.hydro_diagnosis.cli())"
    done = ran(sys.executable, "-c", started, "nothing.csv", "--out", tmp_path / "report", env=environment)
    (sentence,) = done.stderr.strip().splitlines()
    assert done.returncode == 2
    assert str(broken) in sentence and why in sentence and sentence.endswith("fix the file or remove it")
