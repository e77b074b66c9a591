# SPDX-License-Identifier: Apache-2.0
"""The effect's module and its test, written from the sightings of a law.

The source text of a law's shape is traced: the shape is called once with values that record the operations.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from hydro_bridge.files.atomic import write_whole
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.growing.sightings import Agreement, Sighting, units
from hydro_sim.model.bench import Bench
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Law

_OPERATORS: dict[str, type[ast.operator]] = {
    "add": ast.Add, "sub": ast.Sub, "mul": ast.Mult, "truediv": ast.Div, "pow": ast.Pow,
}  # fmt: skip
_UFUNCS: dict[str, type[ast.operator]] = {
    "add": ast.Add, "subtract": ast.Sub, "multiply": ast.Mult, "divide": ast.Div, "power": ast.Pow,
}  # fmt: skip
"""numpy's names of the operators, which a number of numpy's on the left calls."""


class Traced:
    """A value as the expression that gives it."""

    def __init__(self, node: ast.expr) -> None:
        self.node = node

    def __neg__(self) -> Traced:
        return Traced(ast.UnaryOp(ast.USub(), self.node))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **_: Any) -> Traced:
        nodes = [_node(one) for one in given]
        if ufunc.__name__ in _UFUNCS:
            return Traced(ast.BinOp(nodes[0], _UFUNCS[ufunc.__name__](), nodes[1]))
        name = {"absolute": "abs", "negative": "negative"}.get(ufunc.__name__, ufunc.__name__)
        return Traced(ast.Call(ast.Attribute(ast.Name("np"), name), nodes, []))


def _operator(kind: type[ast.operator], *, swapped: bool) -> Callable[[Traced, Any], Traced]:
    def applied(self: Traced, other: Any) -> Traced:
        left, right = (_node(other), self.node) if swapped else (self.node, _node(other))
        return Traced(ast.BinOp(left, kind(), right))

    return applied


for _name, _kind in _OPERATORS.items():
    setattr(Traced, f"__{_name}__", _operator(_kind, swapped=False))
    setattr(Traced, f"__r{_name}__", _operator(_kind, swapped=True))


def _node(value: Any) -> ast.expr:
    return value.node if isinstance(value, Traced) else ast.Constant(float(value))


class _Numbers:
    """The bench's numbers, each by its name."""

    def __getattr__(self, name: str) -> Traced:
        return Traced(ast.Attribute(ast.Name("n"), name))


def shape_text(law: Law) -> str:
    """The law's shape as a Python expression of `at` (`Signals`) and `n` (the bench's numbers).

    Raises
    ------
    TypeError
        The shape does more than arithmetic and numpy's functions of single values.
    """
    at = Signals(**{one.name: Traced(ast.Attribute(ast.Name("at"), one.name)) for one in fields(Signals)})
    return ast.unparse(_node(law.shape(at, _Numbers())))


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
        "summary": f"`{law.text}`.",
        "sentence": _wrapped(law.sentence),
        "table": textwrap.indent(table(found), "    "),
        "sentences": "\n".join(textwrap.fill(one.sentence, _WIDTH) for one in agreed),
        "shape": shape_text(law),
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
