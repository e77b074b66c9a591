# SPDX-License-Identifier: Apache-2.0
"""Python source, for numba, of expressions of CasADi's symbols: what several terms share is computed once.

`model.source` writes C from the same list of elementary operations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi
from casadi import SX

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


def _nodes(function: casadi.Function, texts: Sequence[str]) -> list[Node]:
    """The outputs of a function."""
    work: dict[int, Node] = {}
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
        else:
            form, precedence = _OPERATIONS[operation]
            work[written[0]] = _either(Node(form, precedence, _operands(operation, [work[one] for one in read])))
    return [roots[i] for i in range(len(roots))]


def _operands(operation: int, read: list[Node]) -> tuple[Node, ...]:
    """Operands in the order of an operation's text."""
    if operation in (casadi.OP_IF_ELSE_ZERO, casadi.OP_LE, casadi.OP_LT):
        return read[1], read[0]
    if operation in (casadi.OP_TWICE, casadi.OP_INV):
        return (_TWO if operation == casadi.OP_TWICE else _ONE), read[0]
    return tuple(read)


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
    words = []
    for place, operand in enumerate(node.operands):
        precedence = ATOM if operand in names else operand.precedence
        bracket = node.precedence < ATOM and precedence < node.precedence + (place > 0)
        words.append(f"({_text(operand, names)})" if bracket else _text(operand, names))
    return node.form.format(*words)


_TWO, _ONE = Node("2.0", ATOM), Node("1.0", ATOM)
_IF = "{} if {} else 0.0"
_OPERATIONS = {
    casadi.OP_ADD: ("{} + {}", 3), casadi.OP_SUB: ("{} - {}", 3), casadi.OP_MUL: ("{} * {}", 4),
    casadi.OP_DIV: ("{} / {}", 4), casadi.OP_NEG: ("-{}", 5), casadi.OP_SQ: ("{}**2", 6),
    casadi.OP_TWICE: ("{} * {}", 4), casadi.OP_INV: ("{} / {}", 4), casadi.OP_SQRT: ("math.sqrt({})", ATOM),
    casadi.OP_EXP: ("math.exp({})", ATOM), casadi.OP_LE: ("{} >= {}", 2), casadi.OP_LT: ("{} > {}", 2),
    casadi.OP_NOT: ("not {}", 1), casadi.OP_IF_ELSE_ZERO: (_IF, 0),
}  # fmt: skip
