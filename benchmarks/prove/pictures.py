# SPDX-License-Identifier: Apache-2.0
"""proof.html: standards, failures, and plots of confusion and of errors against size."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.prove.cases import FITTED, SECONDS
from benchmarks.prove.scores import Result, confusion
from hydro_bridge.cli.console import Table
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.pages import Section, results_page
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.selection.search import SearchSettings
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, figure

_CAPTIONS = {
    "confusion": "What was said about each cause that was concealed alone; numbers are cases, blue is their share.",
    "errors": "Error of the size of each cause that was concealed alone, against how large it was. The detection floor "
    "is the size at which evidence would just be enough, or from which on it is worth claiming.",
}


def write_page(path: Path, table: Table, pictures: Mapping[str, Path], failed: Sequence[Mapping[str, Any]],
          about: Mapping[str, str]) -> None:  # fmt: skip
    """Write the page; `about`: facts on the run, by name."""
    cases = Table(dict.fromkeys(("case", "kind", "concealed", "verdict", "claimed"), ""), title="Failures")
    for one in failed:
        cases.add(case=one["case"], kind=one["kind"], concealed=_flat(one["truth"]), verdict=one["verdict"],
                  claimed=f"{_flat(one['claimed'])} {one['why']}")  # fmt: skip
    shown = [
        Section(heading="Standards", table=table),
        *(Section(heading=what, text=_CAPTIONS[what], picture=file) for what, file in pictures.items()),
        Section(heading="Failures", table=cases) if failed else Section(heading="Failures", text="None."),
    ]
    write_whole(path, results_page("Proof on sealed cases", about, shown).encode())


def _flat(data: Mapping[str, Any]) -> str:
    return yaml.safe_dump(_rounded(data), default_flow_style=True, width=10**6).strip() if data else ""


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


_VERDICTS = ("no_mismatch", "unknown", "partly_explained", "modelled", "explained", "refused")


def draw(results: Sequence[Result], folder: Path) -> dict[str, Path]:
    """Draw all pictures into `folder`."""
    paths = {what: folder / f"{what}.png" for what in _CAPTIONS}
    draw_confusion(confusion(results), paths["confusion"])
    draw_errors(results, paths["errors"])
    return paths


def draw_confusion(matrix: dict[str, dict[str, int]], path: Path) -> None:
    """Confusion matrix. Rows: concealed causes; columns: claimed ones."""
    rows = sorted(matrix, key=lambda name: (name == "nothing", name))
    said = {name for counts in matrix.values() for name in counts}
    columns = [name for name in rows if name in said] + sorted(said - set(rows) - set(_VERDICTS))
    columns += [name for name in _VERDICTS if name in said]
    share = np.array([[matrix[row].get(column, 0) / sum(matrix[row].values()) for column in columns] for row in rows])
    size = (1.8 + 0.22 * len(columns), 1.6 + 0.2 * len(rows))
    with figure(path, size=size) as (_, (axis,)):
        axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axis.grid(visible=False)
        axis.set_xticks(range(len(columns)), [_words(name) for name in columns], rotation=90, fontsize=7)
        axis.set_yticks(range(len(rows)), [_words(name) for name in rows], fontsize=7)
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                if matrix[row].get(column):
                    axis.text(j, i, matrix[row][column], ha="center", va="center", fontsize=6,
                              color="white" if share[i, j] > 0.6 else "black")  # fmt: skip
        axis.set(xlabel="said", ylabel="concealed, alone")


def floors(results: Sequence[Result]) -> dict[str, float]:
    """Detection floor by cause: the size at which evidence would just suffice, at least the smallest worth claiming.

    Evidence grows with the square of the size: floor = size sqrt(threshold / evidence), median over the cases in which
    the cause was concealed alone and named.
    """
    needed = SearchSettings().threshold + np.log(1e3 * SECONDS * len(FITTED))
    worth = {(effect.id, one.name): one.smallest for effect in LIBRARY for one in effect.parameters}
    by_cause: dict[str, list[float]] = defaultdict(list)
    for result, (name, size) in _alone(results):
        cause, evidence = result.effects[0]["id"], result.effects[0]["evidence"]["delta_bic"]
        enough = size * float(np.sqrt(needed / max(evidence, needed)))
        by_cause[cause].append(max(enough, worth[cause, name]))
    return {cause: float(np.median(sizes)) for cause, sizes in by_cause.items()}


def _alone(results: Sequence[Result]) -> Iterator[tuple[Result, tuple[str, float]]]:
    """Cases with one cause that was named, and its size."""
    for result in results:
        if result.case.kind in ("single", "value", "faint") and result.case.size and result.exact:
            yield result, result.case.size


def draw_errors(results: Sequence[Result], path: Path) -> None:
    """Relative error of every size against the size, in multiples of the cause's detection floor."""
    floor = floors(results)
    causes = sorted(floor)
    with figure(path, size=(8.0, 5.0)) as (_, (axis,)):
        for k, cause in enumerate(causes):
            points = [
                (size / floor[cause], one.error_of_size)
                for result, (name, size) in _alone(results)
                for one in result.estimates
                if one.cause == cause and one.name == name
            ]
            marker = "osD^vP*X"[k // 7 % 8]
            color = (BLUE, ORANGE, GREEN, RED, GRAY, "#cc79a7", "#56b4e9")[k % 7]
            if points:
                axis.plot(*zip(*points, strict=True), marker, color=color, markersize=4, label=_words(cause))
        axis.axvline(1.0, color=GRAY, linestyle="--", linewidth=1.0)
        axis.axhline(0.005, color=GRAY, linestyle=":", linewidth=1.0)
        axis.set(xscale="log", yscale="log", xlabel="size over the cause's detection floor (dashed: floor)",
                 ylabel="error of the size, over the size (dotted: 0.5 %)")  # fmt: skip
        axis.legend(fontsize=6, ncols=1, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _words(name: Any) -> str:
    return str(name).replace("_", " ")
