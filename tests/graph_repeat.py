# SPDX-License-Identifier: Apache-2.0
"""Every graph test many times over, beside one process that is always busy: `make graph-repeat N=100 ARGS="-k arm"`.

Stops at the first repetition in which a test fails, says which test and which repetition, and shows what it printed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

from hydro_bridge.cli.console import Table, add_json_argument, command, progress

COLUMNS = {
    "test": "",
    "passes": "repetitions in which it passed",
    "failed": "those in which it did not, counted from 1",
}

NONE_COLLECTED = 5
"""pytest's exit status."""


def busy() -> None:
    """Compute without end."""
    while True:
        pass


def repetition(words: list[str], folder: Path) -> tuple[dict[str, bool], str]:
    """Run the graph tests once: which of them passed, and what pytest printed."""
    report = folder / "report.xml"
    report.unlink(missing_ok=True)
    pytest = [sys.executable, "-m", "pytest", "-q", "-m", "graph", f"--junitxml={report}", *words]
    done = subprocess.run(pytest, capture_output=True, text=True, check=False)
    if done.returncode == NONE_COLLECTED or not report.exists():
        return {}, done.stdout + done.stderr
    return read_report(report), done.stdout


def read_report(report: Path) -> dict[str, bool]:
    """Test -> whether it passed, of pytest's XML; skipped ones are left out."""
    cases = ElementTree.parse(report).getroot().iter("testcase")
    return {
        f"{case.get('classname', '').rpartition('.')[2]}::{case.get('name')}": not _has(case, "failure", "error")
        for case in cases
        if not _has(case, "skipped")
    }


def _has(case: ElementTree.Element, *tags: str) -> bool:
    return any(case.find(tag) is not None for tag in tags)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="python -m tests.graph_repeat", description=__doc__)
    result.add_argument("--times", type=int, default=100, metavar="N", help="repetitions (default: %(default)s)")
    result.add_argument("-k", metavar="EXPRESSION", help="some of the tests, as for pytest")
    result.add_argument("--keep-going", action="store_true", help="go on after a failure, to count them")
    result.add_argument("tests", nargs="*", metavar="FILE", help="of some files")
    add_json_argument(result)
    return result


@command()
def main() -> int:
    """Repeat, print the table; exit status 1 if anything failed."""
    asked = parser().parse_args()
    words = [*asked.tests, *(["-k", asked.k] if asked.k else [])]
    passes: Counter[str] = Counter()
    failures: dict[str, list[int]] = {}
    beside = multiprocessing.get_context("spawn").Process(target=busy, daemon=True)
    beside.start()
    with tempfile.TemporaryDirectory() as folder, progress(total=asked.times, label="repetitions", unit="run") as bar:
        for number in range(1, asked.times + 1):
            outcome, printed = repetition(words, Path(folder))
            passes.update({test: int(passed) for test, passed in outcome.items()})
            failed = [test for test, passed in outcome.items() if not passed]
            for test in failed:
                failures.setdefault(test, []).append(number)
            bar.update()
            if failed or not outcome:
                print(printed, file=sys.stderr)
                print(f"repetition {number}: {', '.join(failed) or 'nothing ran'}", file=sys.stderr)
            if not outcome or (failed and not asked.keep_going):
                break
    beside.terminate()
    table = Table(COLUMNS, title="Graph tests beside one busy process")
    for test in sorted(passes):
        table.add(test=test, passes=passes[test], failed=", ".join(map(str, failures.get(test, []))) or "none")
    table.show(asked.json)
    return 1 if failures or not passes else 0


if __name__ == "__main__":
    main()
