# SPDX-License-Identifier: Apache-2.0
"""Record of a commissioning: DIR/commission.json (files.md), its page report.html, and the validity of its gates.

A passed gate is valid while the files that it read and wrote have unchanged digests.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.pages import Section, results_page
from hydro_core.cli.console import Table, UserError
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_core.files.site import RECORD_FILE
from hydro_policy.task.cases import Score, relative_scores

PAGE_FILE = "report.html"
PASSED, FAILED, SKIPPED, PENDING = "passed", "failed", "skipped", "pending"


_RESULT_FIELDS = {"diagnosis": ("causes",), "metric": ("certified_gains",), "controllers": ("comparison", "watch")}
"""Fields of `Record` filled by each gate, by the gate's name."""


class GateError(Exception):
    """Failure of a commissioning gate; the message is the reason, one sentence."""


class GateSkipped(Exception):  # noqa: N818 - no error
    """Omission of an optional gate; the message names the option that requests it."""


@dataclass(kw_only=True)
class GateResult:
    """Result of one commissioning gate."""

    name: str
    status: str = PENDING  # passed, failed, skipped (not requested) or pending
    seconds: float = 0.0  # wall time of its last run, s
    reason: str = ""  # findings, or reason of the failure, as a sentence
    files: dict[str, str] = field(default_factory=dict)
    """SHA-256 of each file or folder of the site that the gate read or wrote, by name."""


@dataclass(kw_only=True)
class Record:
    """Record of a site's commissioning; the fields are the keys of commission.json."""

    plant: str = ""  # serial port of the box, or `emulator`
    gates: list[GateResult] = field(default_factory=list)
    amplitude: float = 0.0  # amplitude of the sines [N]
    base_gains: list[float] = field(default_factory=list)  # K_p [1/s], K_i [1/s^2] of the box
    cell_noise: float = 0.0  # standard deviation of the load cell's noise at rest [N]
    drift: str = ""  # warning about a drift of the load force at rest; empty: none
    causes: list[dict[str, Any]] = field(default_factory=list)  # `effects` of the diagnosis' report.json
    certified_gains: dict[str, list[float]] = field(default_factory=dict)
    """Range of K_p [1/s] that the metric certifies, by force law: `paper`, `compensated`."""
    comparison: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Results by controller: `name`, `rmse` [N] by reference (null: stopped) and `trips`, number of stopped runs."""
    adopted: str = ""  # key of the best in `comparison`
    watch: list[str] = field(default_factory=list)  # points to observe in operation, as sentences

    @classmethod
    def load(cls, folder: Path, names: Sequence[str]) -> Record:
        """Read the record of a site with the gates `names`; a new record if the site has none.

        Raises UserError: the file is damaged, or has other gates.
        """
        file = folder / RECORD_FILE
        if not file.is_file():
            return cls(gates=[GateResult(name=name) for name in names])
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            found = cls(**{**content, "gates": [GateResult(**entry) for entry in content["gates"]]})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{file} is not a record of a commissioning ({error}): name another folder") from None
        if [gate.name for gate in found.gates] != list(names):
            raise UserError(f"{file} has other gates than this version: name another folder")
        return found

    def reset_invalid_gates(self, folder: Path, first: int) -> int:
        """Return the number of leading gates that are still valid, at most `first`, and reset all gates after them.

        A gate is valid if it passed or was skipped, and its files are unchanged. A reset also clears `adopted`.
        """
        count = 0
        for gate in self.gates[:first]:
            if gate.status == PENDING or gate.status == FAILED or gate.files != digests(folder, gate.files):
                break
            count += 1
        for gate in self.gates[count:]:
            gate.status, gate.reason, gate.files, self.adopted = PENDING, "", {}, ""
            for field_name in _RESULT_FIELDS.get(gate.name, ()):
                getattr(self, field_name).clear()
        return count

    def write(self, folder: Path) -> None:
        """Write commission.json and report.html."""
        write_atomic(folder / RECORD_FILE, encode_json(self))
        causes = Table({"cause": "", "sentence": ""})
        for cause in self.causes:
            causes.add(cause=cause["id"], sentence=cause["sentence"])
        gains = (f"{law} law: K_p {low:g} to {high:g} 1/s" for law, (low, high) in self.certified_gains.items())
        sections = [
            Section(heading="Gates", table=self.table()),
            Section(heading="Comparison", table=self.comparison_table()),
            Section(heading="Causes beside the bench file", table=causes),
            Section(heading="Certified gains", text=", ".join(gains)),
            Section(heading="What to watch", text=" ".join(self.watch)),
        ]
        shown = [section for section in sections if section.text or (section.table and section.table.rows)]
        about = {"plant": self.plant, "adopted": self.comparison.get(self.adopted, {}).get("name", "nothing yet")}
        write_atomic(folder / PAGE_FILE, results_page(f"Commissioning of {folder.name}", about, shown).encode())

    def table(self) -> Table:
        """Return the table of the gates: status, wall time [s], findings."""
        table = Table({"gate": "", "status": "", "seconds": "s, wall time", "found": ""}, title="Gates")
        for gate in self.gates:
            table.add(gate=gate.name, status=gate.status, seconds=round(gate.seconds, 1), found=gate.reason)
        return table

    def comparison_table(self) -> Table:
        """Return the table of the comparison: force RMSE [N] by controller and reference, stopped runs."""
        cases = list(dict.fromkeys(case for entry in self.comparison.values() for case in entry["rmse"]))
        title = f"Force RMSE [N], sines of {self.amplitude:.0f} N"
        table = Table({"controller": "", **dict.fromkeys(cases, ""), "trips": "stopped runs"}, title=title)
        for key, entry in self.comparison.items():
            if not (entry["rmse"] or entry["trips"]):
                continue
            told = f"{key}: {entry['name']}" + (", adopted" if key == self.adopted else "")
            cells = {case: entry["rmse"].get(case, "-") for case in cases}
            table.add(controller=told, **cells, trips=entry["trips"])
        return table


def digests(folder: Path, names: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Return the SHA-256 of files and folders of a site, by name; empty for a missing file or an empty folder."""
    found = {}
    for name in names:
        path, total = folder / name, sha256()
        files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
        there = bool(files) and all(file.is_file() for file in files)
        for file in files if there else ():
            total.update(file.read_bytes())
        found[name] = total.hexdigest() if there else ""
    return found


def controller_scores(scores: Sequence[Score]) -> dict[str, dict[str, Any]]:
    """Return the results by controller: `name`, `rmse` [N] by reference, and `trips`, the number of stopped runs.

    An RMSE is the mean over repeats; None if one of them was stopped.
    """
    found: dict[str, dict[str, Any]] = {}
    for score in scores:
        entry = found.setdefault(score.controller, {"name": score.controller, "rmse": {}, "trips": 0})
        entry["trips"] += bool(score.stopped)
        entry["rmse"].setdefault(score.case, []).append(score.rmse)
    for entry in found.values():
        means = {case: float(np.mean(values)) for case, values in entry["rmse"].items()}
        entry["rmse"] = {case: mean if np.isfinite(mean) else None for case, mean in means.items()}
    return found


def best(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the key of the entry with the smallest mean ratio of its RMSE to the smallest RMSE on each reference.

    Entries with a stopped run are excluded; empty if no entry is left.
    """
    whole = {key: [*entry["rmse"].values()] for key, entry in entries.items() if entry["rmse"] and not entry["trips"]}
    scores = relative_scores(whole)
    return min(scores, key=scores.__getitem__, default="")
