# SPDX-License-Identifier: Apache-2.0
"""Every function of the packages is annotated, except those that numba compiles and types by itself."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MODULES = sorted(path for path in ROOT.glob("src/hydro_*/hydro_*/**/*.py"))
COMPILED = ("njit", "register_jitable", "vectorize", "guvectorize", "cfunc", "overload")


def is_compiled(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any(name in ast.unparse(decorator) for decorator in function.decorator_list for name in COMPILED)


def missing(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
    bare = [
        word.arg for word in named if word is not None and word.annotation is None and word.arg not in ("self", "cls")
    ]
    return bare if function.returns else [*bare, "return"]


def chosen_by_overload(tree: ast.AST) -> set[str]:
    """Names that stand for compiled code: what `overload` is for, and what its functions return."""
    overloads = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any("overload" in ast.unparse(word) for word in node.decorator_list)
    ]
    words = [word for node in overloads for word in node.decorator_list]
    words += [word for node in overloads for word in ast.walk(node) if isinstance(word, ast.Return)]
    return {name.id for word in words for name in ast.walk(word) if isinstance(name, ast.Name)}


def functions(tree: ast.AST) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Return the functions to check: none inside a compiled one."""
    found: list[ast.FunctionDef | ast.AsyncFunctionDef] = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            if is_compiled(node):
                continue
            found.append(node)
        found += functions(node)
    return found


def test_functions_are_annotated() -> None:
    lacking = {}
    for path in MODULES:
        tree = ast.parse(path.read_text())
        compiled = chosen_by_overload(tree)
        lacking |= {
            f"{path}:{one.lineno} {one.name}": missing(one) for one in functions(tree) if one.name not in compiled
        }
    assert len(lacking) > 1000
    assert {name: words for name, words in lacking.items() if words} == {}
