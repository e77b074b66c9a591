# SPDX-License-Identifier: Apache-2.0
"""Pages say what is there: commands, options, modules, generated pages, and links outside of the site.

`make docs` checks those of the site.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import pydoc
import re
import shlex
from functools import lru_cache
from pathlib import Path

from docs import generate_reference
from hydro_bridge.arguments import sections
from hydro_core.settings import read_yaml
from hydro_policy.nodes.plants import EXECUTABLES

ROOT = Path(__file__).resolve().parent.parent
FRONT = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
PAGES = {path: path.read_text(encoding="utf-8") for path in (*FRONT, *sorted((ROOT / "docs").rglob("*.md")))}


@lru_cache
def parser_of(package: str, name: str) -> argparse.ArgumentParser:
    return generate_reference.parser_of(generate_reference.executables(package)[name])


def where(path: Path, what: str) -> str:
    return f"{path.relative_to(ROOT)}: {what}"


def test_links_of_the_pages_outside_of_the_site_lead_somewhere() -> None:
    links = [(path, link.split("#")[0]) for path in FRONT for link in re.findall(r"\]\(([^)\s]+)\)", PAGES[path])]
    assert [where(path, link) for path, link in links if "://" not in link and not (ROOT / link).exists()] == []


def test_commands_and_modules_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    unknown = []
    for path, text in PAGES.items():
        runs = re.findall(r"ros2 run (\w+) (\w+)", text)
        unknown += [
            where(path, f"{one} {name}") for one, name in runs if name not in generate_reference.executables(one)
        ]
        made = re.findall(r"(?:^|`)\s*make ([a-z][a-z-]*)", text, re.MULTILINE)
        unknown += [where(path, f"make {target}") for target in made if target not in targets]
        for name in re.findall(r"python -m ((?:benchmarks|demo|tests)[\w.]*)", text):
            place = ROOT / name.replace(".", "/")
            if not place.with_suffix(".py").exists() and not (place / "__main__.py").exists():
                unknown.append(where(path, name))
    assert unknown == []


def test_options_are_known_to_their_commands() -> None:
    unknown = []
    for path, text in PAGES.items():
        for line in re.findall(r"^[ \t]*(ros2 run \w+ \w+(?:[ \t].*)?)$", text.replace("\\\n", " "), re.MULTILINE):
            words = shlex.split(re.split(r"\s#\s|\s{3,}| --ros-args| > | && ", line)[0])
            known = parser_of(words[2], words[3])._option_string_actions
            options = [word for word in words[4:] if word.startswith("--") and word.split("=")[0] not in known]
            unknown += [where(path, option) for option in options]
    assert unknown == []


def test_graph_files_give_their_nodes_options_that_these_take() -> None:
    files = sorted(ROOT.glob("src/*/launch/*.yaml"))
    assert [path.stem for path in files] == ["bench", "emulator", "sim"]
    for path in files:
        for pattern, given in sections(read_yaml(path)):
            known = {action.dest for action in parser_of(*EXECUTABLES[pattern.strip("/")])._actions}
            assert {name for name in given if "." not in name} <= known, (path.name, pattern)


def test_python_blocks_import_what_is_there() -> None:
    lost = []
    for path, text in PAGES.items():
        for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("hydro_"):
                    module = importlib.import_module(node.module)
                    names = [name.name for name in node.names if not hasattr(module, name.name)]
                    lost += [where(path, f"{node.module}.{name}") for name in names]
    assert lost == []


def test_files_that_the_table_of_failures_names_hold_tests() -> None:
    table = next(text for path, text in PAGES.items() if path.name == "failures.md")
    named = {cell for row in re.findall(r"^\|.*\| ([a-z_/, ]+) \|$", table, re.MULTILINE) for cell in row.split(", ")}
    files = {name: ROOT / ("src/hydro_{}/test/{}.py" if "/" in name else "tests/{}.py").format(*name.split("/"))
             for name in named - {"tests"}}  # fmt: skip
    assert len(files) > 20
    assert [name for name, path in files.items() if not path.exists() or "def test_" not in path.read_text()] == []


def test_pages_of_the_site_are_committed_or_generated() -> None:
    named = set(re.findall(r": ((?:manual|reports)/\S+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE))
    generated = generate_reference.pages()
    assert {path for path in named if not (ROOT / "docs" / path).exists()} == set(generated)
    assert [path for path, text in generated.items() if text.count("\n") < 10] == []


def test_pages_that_the_sources_name_are_there() -> None:
    """Sources name a page by its file's name alone; what a user reads has the whole path."""
    names = {path.name for path in PAGES}
    assert len(names) == len(PAGES)
    lost = []
    for folder in ("src", "demo", "benchmarks", "tests", "setup"):
        for source in (ROOT / folder).rglob("*.py"):
            for name in re.findall(r"(?<![\w./-])((?:docs/[\w/-]+/)?[a-z][\w-]*\.md)\b", source.read_text("utf-8")):
                if not ((ROOT / name).exists() if "/" in name else name in names):
                    lost.append(where(source, name))
    assert lost == []


def test_homes_in_the_table_of_concepts_are_there() -> None:
    page = next(text for path, text in PAGES.items() if path.name == "architecture.md")
    table = page.partition("## One concept, one home")[2].partition("\n\n|")[2].partition("\n\n")[0]
    homes = [home for row in table.splitlines() for home in re.findall(r"`([\w./]+)`", row.split("|")[-2])]
    assert len(homes) > 40
    assert [home for home in homes if not ((ROOT / home).exists() if "/" in home else pydoc.locate(home))] == []


def test_decisions_have_at_most_fifteen_lines() -> None:
    assert [
        path.name for path, text in PAGES.items() if path.parent.name == "decisions" and text.count("\n") > 15
    ] == []
