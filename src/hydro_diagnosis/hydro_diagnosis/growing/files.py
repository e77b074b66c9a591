# SPDX-License-Identifier: Apache-2.0
"""The effect's module and its test, written from the sightings of a law."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from hydro_bridge.files.atomic import write_whole
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.growing.sightings import Agreement, Sighting, units
from hydro_sim.model.bench import Bench

REACH = 10.0
"""Bounds of a parameter, over the largest and under the smallest value that was seen."""
_WIDTH = 120


def written(name: str, found: Sequence[Sighting], agreed: Sequence[Agreement], folder: Path, tests: Path) -> list[Path]:
    """Write the module of the effect `name` and its test, and return both paths."""
    about = _about(name, found, agreed)
    made = []
    for template, path in zip(("effect", "test_effect"), paths(name, folder, tests), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, _templates().get_template(f"{template}.py.jinja").render(about).encode())
        made.append(path)
    return made


def paths(name: str, folder: Path, tests: Path) -> tuple[Path, Path]:
    """Module and test of an effect."""
    return folder / f"{name}.py", tests / f"test_{name}.py"


def _templates() -> Environment:
    return Environment(
        loader=PackageLoader("hydro_diagnosis", "growing/templates"), undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip


def _about(name: str, found: Sequence[Sighting], agreed: Sequence[Agreement]) -> Mapping[str, Any]:
    law = found[0].law
    common = {one.name: _short(one.common) for one in agreed}
    return {
        "id": name,
        "law": law,
        "found": found,
        "title": textwrap.fill(law.sentence, _WIDTH, initial_indent="   ").strip(),
        "sentence": _wrapped(law.sentence),
        "table": textwrap.indent(table(found), "    "),
        "sentences": "\n".join(textwrap.fill(one.sentence, _WIDTH) for one in agreed),
        "typical": abs(common["coefficient"]),
        "numbers": _tuple([f'Number("{one.name}", "{one.unit}", ({common[one.name]},))' for one in law.numbers]),
        "bounds": {one.name: _bounds(one.name, found) for one in agreed},
        "seen": common,
        "equations": _tuple([f'"{one}"' for one in closure(law, Bench.nominal()).equations]),
        "amplitude": 560.0 if "from A to B" in law.form else 260.0,
    }


def table(found: Sequence[Sighting]) -> str:
    """The numbers side by side with their 95 % intervals; reports by the last two folders of their paths."""
    rows = []
    for name, unit in units(found[0].law).items():
        for one in found:
            estimate = one.estimates[name]
            known = estimate.low is not None and estimate.high is not None
            interval = f"95 % {estimate.low:.4g} to {estimate.high:.4g}" if known else "not identified"
            rows.append((_place(one.report), f"{name} = {estimate.value:.4g} {unit}", interval))
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _place(report: str) -> str:
    path = Path(report)
    return "/".join((path.parent if path.suffix == ".json" else path).parts[-2:]) or report


def _bounds(name: str, found: Sequence[Sighting]) -> tuple[float, float]:
    """Bounds of a parameter: ten times what was seen; on one side of 0 if all values and intervals are."""
    ends = [end for one in found for end in _ends(one, name)]
    low, high = min(ends), max(ends)
    if low < 0.0 < high:
        reach = REACH * max(-low, high)
        return _short(-reach), _short(reach)
    near = 0.0 if name == "coefficient" else 1.0 / REACH
    return _short(low * (near if low > 0.0 else REACH)), _short(high * (REACH if high > 0.0 else near))


def _ends(one: Sighting, name: str) -> list[float]:
    estimate = one.estimates[name]
    return [end for end in (estimate.low, estimate.value, estimate.high) if end is not None]


def _short(value: float) -> float:
    """Four digits: more were not seen."""
    return float(f"{value:.4g}") + 0.0


def _tuple(items: Sequence[str]) -> str:
    return f"({items[0]},)" if len(items) == 1 else f"({', '.join(items)})"


def _wrapped(sentence: str) -> str:
    """A text as Python source, over several lines if it is long."""
    if len(sentence) <= _WIDTH - 20:
        return f'"{sentence}"'
    lines = textwrap.wrap(sentence, _WIDTH - 14, drop_whitespace=False)
    return "(\n" + "".join(f'            "{line}"\n' for line in lines) + "        )"
