# SPDX-License-Identifier: Apache-2.0
"""Source text of a law's shape: the shape is called once with values that write down what is done to them."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

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
