# SPDX-License-Identifier: Apache-2.0
"""Python source, for numba, of expressions of CasADi's symbols: what several terms share is computed once.

So are reciprocals: derivatives divide by the same volume, mass or root again and again. `model.source` writes C from
the same list of elementary operations.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi
from casadi import SX

casadi.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols are symbols, without a warning

ATOM = 9
"""Precedence of what needs no brackets."""


@dataclass(frozen=True, eq=False)
class Node:
    """An elementary operation."""

    form: str
    """Its text, with a place for each operand."""
    precedence: int
    operands: tuple[Node, ...] = ()


def statements(symbols: Mapping[str, SX], outputs: Sequence[tuple[str, SX]]) -> list[str]:
    """Statements that compute scalar expressions.

    Parameters
    ----------
    symbols
        The scalar symbols, by their text in Python.
    outputs
        What is written before each expression, such as `p[0, 1] = `, and the expression.
    """
    expressions = casadi.cse(casadi.vertcat(*(casadi.densify(expression) for _, expression in outputs)))
    function = casadi.Function("f", [casadi.vertcat(*symbols.values())], [expressions])
    roots = _nodes(function, list(symbols))
    uses = Counter(operand for node in _below(roots) for operand in node.operands) + Counter(roots)
    lines: list[str] = []
    names: dict[Node, str] = {}
    for root, (begin, _) in zip(roots, outputs, strict=True):
        lines += [f"{names[node]} = {text}" for node, text in _shared(root, uses, names)]
        less = begin.endswith("+= ") and root.form == "-{}" and root not in names
        lines.append(f"{begin[:-3]}-= {_text(root.operands[0], names)}" if less else f"{begin}{_text(root, names)}")
    return lines


def formatted(head: str, functions: Sequence[tuple[str, str, Sequence[str]]], file: Path) -> str:
    """A file's text: its head, then compiled functions, each a signature, a docstring and its lines."""
    text = head
    for signature, docstring, lines in functions:
        body = "\n    ".join(lines)
        text += f'\n\n@njit\ndef {signature}:\n    """{docstring}"""\n    {body}\n'
    command = [sys.executable, "-m", "ruff", "format", "-", "--stdin-filename", str(file)]
    return subprocess.run(command, input=text, text=True, capture_output=True, check=True).stdout


def _nodes(function: casadi.Function, texts: Sequence[str]) -> list[Node]:
    """The outputs of a function."""
    work: dict[int, Node] = {}
    reciprocals: dict[Node, Node] = {}
    roots: dict[int, Node] = {}
    for i in range(function.n_instructions()):
        operation, read = function.instruction_id(i), function.instruction_input(i)
        written = function.instruction_output(i)
        if operation == casadi.OP_INPUT:
            work[written[0]] = Node(texts[read[1]], ATOM)
        elif operation == casadi.OP_CONST:
            work[written[0]] = Node(repr(function.instruction_constant(i)), ATOM)
        elif operation == casadi.OP_OUTPUT:
            roots[written[1]] = work[read[0]]
        elif operation in (casadi.OP_DIV, casadi.OP_INV):
            *above, below = (work[one] for one in read)
            work[written[0]] = _quotient(above[0] if above else _ONE, below, reciprocals)
        else:
            form, precedence = _OPERATIONS[operation]
            work[written[0]] = _either(Node(form, precedence, _operands(operation, [work[one] for one in read])))
    return [roots[i] for i in range(len(roots))]


def _quotient(above: Node, below: Node, reciprocals: dict[Node, Node]) -> Node:
    """`above` times the reciprocal of `below`, which all quotients with it share."""
    if below.operands and below.operands[0] is _TWO:
        return _quotient(Node(_MUL, 4, (above, _HALF)), below.operands[1], reciprocals)
    reciprocal = reciprocals.setdefault(below, Node(_DIV, 4, (_ONE, below)))
    return reciprocal if above is _ONE else Node(_MUL, 4, (above, reciprocal))


def _operands(operation: int, read: list[Node]) -> tuple[Node, ...]:
    """Operands in the order of an operation's text."""
    if operation in (casadi.OP_IF_ELSE_ZERO, casadi.OP_LE, casadi.OP_LT):
        return read[1], read[0]
    return (_TWO, read[0]) if operation == casadi.OP_TWICE else tuple(read)


def _either(node: Node) -> Node:
    """`x if c else y` of CasADi's sum of `x if c else 0` and `y if not c else 0`."""
    first, second = node.operands if node.form == "{} + {}" else (node, node)
    if first is second or first.form != _IF or second.form != _IF:
        return node
    (value, condition), (other, contrary) = first.operands, second.operands
    if contrary.form != "not {}" or contrary.operands[0] is not condition:
        return node
    return Node("{} if {} else {}", 0, (value, condition, other))


def _below(roots: Sequence[Node]) -> list[Node]:
    """All nodes that the roots need."""
    found: dict[Node, None] = {}
    waiting = list(roots)
    while waiting:
        node = waiting.pop()
        if node not in found:
            found[node] = None
            waiting += node.operands
    return list(found)


def _shared(node: Node, uses: Counter[Node], names: dict[Node, str]) -> list[tuple[Node, str]]:
    """Nodes below this one that get a name, each after those that it needs; not those that have one."""
    if node in names or not node.operands:
        return []
    made = [one for operand in node.operands for one in _shared(operand, uses, names)]
    if uses[node] > 1:
        made.append((node, _text(node, names)))
        names[node] = f"a{len(names)}"
    return made


def _text(node: Node, names: Mapping[Node, str]) -> str:
    if node in names:
        return names[node]
    if node.form == _MUL and (last := node.operands[1]).form == _DIV and last not in names:
        node = Node(_DIV, 4, (node.operands[0], last.operands[1]))  # nobody shares the reciprocal
    words = []
    for place, operand in enumerate(node.operands):
        precedence = ATOM if operand in names else operand.precedence
        bracket = node.precedence < ATOM and precedence < node.precedence + (place > 0)
        words.append(f"({_text(operand, names)})" if bracket else _text(operand, names))
    return node.form.format(*words)


_HALF, _ONE, _TWO = (Node(text, ATOM) for text in ("0.5", "1.0", "2.0"))
_MUL, _DIV = "{} * {}", "{} / {}"
_IF = "{} if {} else 0.0"
_OPERATIONS = {
    casadi.OP_ADD: ("{} + {}", 3), casadi.OP_SUB: ("{} - {}", 3), casadi.OP_MUL: (_MUL, 4),
    casadi.OP_NEG: ("-{}", 5), casadi.OP_SQ: ("{}**2", 6),
    casadi.OP_TWICE: (_MUL, 4), casadi.OP_SQRT: ("math.sqrt({})", ATOM),
    casadi.OP_EXP: ("math.exp({})", ATOM), casadi.OP_LE: ("{} >= {}", 2), casadi.OP_LT: ("{} > {}", 2),
    casadi.OP_NOT: ("not {}", 1), casadi.OP_IF_ELSE_ZERO: (_IF, 0),
}  # fmt: skip
