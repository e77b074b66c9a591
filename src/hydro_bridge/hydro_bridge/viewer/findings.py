# SPDX-License-Identifier: Apache-2.0
"""Windows of a diagnosis' report.json in which recording and model differ, as marks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from hydro_bridge.bags.types import RecordingError
from hydro_bridge.viewer.marks import Mark

REPORT = "report.json"
_SAME = 1e-3  # s between two stamps of one sample


def report_beside(bag: Path) -> Path | None:
    """Return the report in the same folder as a recording, if there is one."""
    report = bag.absolute().parent / REPORT
    return report if report.is_file() else None


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Findings of a report for each of its recordings."""

    report: Path
    marks: dict[str, list[Mark]]
    """Start of each window by the recording's name, in s from its first sample."""
    begins: list[tuple[str, float | None]]
    """Name and stamp [s] of the first sample of each bag; empty in reports without stamps."""

    def of(self, bag: Path, begin: float) -> list[Mark]:
        """Return those of the recording whose first sample is stamped `begin`; by its name if the report has no stamps.

        Among several with the same start the name decides. A name shared by two recordings is ambiguous and has none.
        """
        named = [name for name in self.marks if Path(name).name in (bag.name, bag.stem)]
        if self.begins:
            every = [name for name, _ in self.begins]
            alike = [name for name, stamp in self.begins if stamp is not None and abs(stamp - begin) < _SAME]
            named = [name for name in alike if len(alike) == 1 or name in named]
            named = [name for name in named if every.count(name) == 1]
        return [mark for name in named for mark in self.marks.get(name, [])]


def read_findings(report: Path) -> Findings:
    """Read report.json of a diagnosis.

    Raises
    ------
    RecordingError
        The file cannot be read, or is not the report of a diagnosis.
    """
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
        marks: dict[str, list[Mark]] = {}
        for place in content["location"]:
            for name, stretches in place["windows"].items():
                told = [
                    f"{place['equation']}, for {end - begin:.2f} s: {place['sentence']}" for begin, end in stretches
                ]
                begins = [float(begin) for begin, _ in stretches]
                marks.setdefault(name, []).extend(map(Mark, begins, ["window"] * len(told), told))
        stamps = [(entry["name"], entry["begin"]) for entry in content.get("recordings", ())]
        return Findings(report=report, marks=marks, begins=stamps)
    except OSError as error:
        raise RecordingError(f"{report}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise RecordingError(f"{report} is no report of a diagnosis") from None
