# SPDX-License-Identifier: Apache-2.0
"""Where a diagnosis found that a recording and the model differ: the windows of its report.json, as marks."""

from __future__ import annotations

import json
from pathlib import Path

from hydro_bridge.bags.types import RecordingError
from hydro_bridge.viewer.marks import Mark

REPORT = "report.json"


def report_beside(bag: Path) -> Path | None:
    """The report that lies in the same folder as a recording, if there is one."""
    report = bag.absolute().parent / REPORT
    return report if report.is_file() else None


def windows(report: Path, bag: Path) -> list[Mark]:
    """A mark where each window begins, in s from the recording's first sample; none if the report is on others.

    Raises
    ------
    RecordingError
        The file cannot be read, or is no report of a diagnosis.
    """
    try:
        return [
            Mark(float(begin), "window", f"{place['equation']}, for {end - begin:.2f} s: {place['sentence']}")
            for place in json.loads(report.read_text(encoding="utf-8"))["location"]
            for name, stretches in place["windows"].items()
            if Path(name).name in (bag.name, bag.stem)
            for begin, end in stretches
        ]
    except OSError as error:
        raise RecordingError(f"{report}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise RecordingError(f"{report} is no report of a diagnosis") from None
