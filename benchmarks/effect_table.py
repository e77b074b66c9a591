# SPDX-License-Identifier: Apache-2.0
"""Which effect stands in which part: a table of the tests that carry `proves(column)`, run now.

A cell is yes where each test of that column passes for that effect, else no. Names of tests stand below the table.
All columns take long, some half an hour of CPU: `--columns` and `--effects` make it in parts, which `--earlier` puts
together.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from benchmarks._report import finish, parser
from hydro_diagnosis.effects import Claim, Effect
from hydro_sim.model.effects.catalogue import CATALOGUE, label

COLUMNS = ("simulated", "differentiated", "identified by learn", "diagnosed", "in the metric's model", "trained on")
FILES = (
    "src/hydro_sim/test/test_bench_model.py", "src/hydro_diagnosis/test/test_simulated_effects.py",
    "tests/test_every_effect.py",
)  # fmt: skip


class Outcomes:
    """What passed, by column and effect: a plugin of pytest."""

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = columns
        self.cells: dict[tuple[str, str], list[bool]] = defaultdict(list)
        self.tests: dict[str, str] = {}
        self._places: dict[str, tuple[str, str]] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep the tests that prove something."""
        kept = []
        for item in items:
            mark = item.get_closest_marker("proves")
            if mark is None or mark.args[0] not in self.columns:
                continue
            kept.append(item)
            self._places[item.nodeid] = mark.args[0], _effect_of(item)
            self.tests[mark.args[0]] = item.nodeid.partition("[")[0]
        items[:] = kept

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note how one ended; an expected failure is one."""
        if report.when == "call" or report.outcome == "failed":
            passed = report.outcome == "passed" and not hasattr(report, "wasxfail")
            self.cells[self._places[report.nodeid]].append(passed)


def _effect_of(item: pytest.Item) -> str:
    """The effect's name in bench files."""
    given: Any = item.callspec.params  # type: ignore[attr-defined]
    effect = given.get("effect")
    if isinstance(effect, Effect):
        return label(Claim(effect, {one.name: one.probes[0] for one in effect.parameters}).to_mapping())
    return str(given["label"])


Cells = dict[str, dict[str, bool]]
"""Whether a column's tests pass, by column and effect."""


def of(outcomes: Outcomes) -> Cells:
    """What was found now."""
    cells: Cells = {}
    for (column, name), passed in outcomes.cells.items():
        cells.setdefault(column, {})[name] = all(passed)
    return cells


def together(parts: Sequence[Any]) -> tuple[Cells, dict[str, str]]:
    """Cells and tests of several runs; the last one counts."""
    cells: Cells = {}
    tests: dict[str, str] = {}
    for part in parts:
        tests |= part["tests"]
        for column, found in part["cells"].items():
            cells.setdefault(column, {}).update(found)
    return cells, tests


def table(cells: Cells, tests: dict[str, str]) -> list[str]:
    """Lines of Markdown."""
    words = {True: "yes", False: "no", None: "not run"}
    lines = [f"| effect | {' | '.join(COLUMNS)} |", "|---" * (len(COLUMNS) + 1) + "|"]
    for name in CATALOGUE:
        row = [words[cells.get(column, {}).get(name)] for column in COLUMNS]
        lines.append(f"| {name} | {' | '.join(row)} |")
    return [*lines, "", *(f"- *{column}*: `{tests[column]}`" for column in COLUMNS if column in tests)]


def main(arguments: list[str] | None = None) -> int:
    """Run, print, write."""
    options = parser("effect_table", __doc__)
    options.add_argument("--columns", nargs="*", choices=COLUMNS, default=list(COLUMNS), help="default all")
    options.add_argument("--effects", metavar="WORDS", default="", help="as pytest's -k; default all")
    options.add_argument("--earlier", nargs="+", type=Path, default=[], metavar="JSON", help="what --json wrote before")
    asked = options.parse_args(arguments)
    outcomes = Outcomes(asked.columns)
    words = ["-q", "--timeout=0", "-p", "no:cacheprovider", *(["-k", asked.effects] if asked.effects else [])]
    status = pytest.main([*words, *FILES], plugins=[outcomes]) if asked.columns else pytest.ExitCode.OK
    found = {"tests": outcomes.tests, "cells": of(outcomes)}
    cells, tests = together([*(json.loads(file.read_text(encoding="utf-8")) for file in asked.earlier), found])
    print("\n".join(table(cells, tests)))
    finish({"tests": tests, "cells": cells}, asked.json)
    return 0 if status in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED) else 1


if __name__ == "__main__":
    sys.exit(main())
