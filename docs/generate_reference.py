# SPDX-License-Identifier: Apache-2.0
"""Reference pages that follow from the code: options of commands, ROS parameters, messages, effects.

The site's build adds them (`docs/site_hooks.py`); they are not committed. `python docs/generate_reference.py` prints
them as a JSON object, text by path below docs/.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hydro_core.settings import describe

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = "manual/reference"
PACKAGES = ("hydro_bridge", "hydro_sim", "hydro_filter", "hydro_policy", "hydro_diagnosis")
WIDTH = 120
SHARED = 3
"""Rows of an earlier command on the page from which on a command refers to it in place of repeating them."""
SETTINGS: dict[str, tuple[tuple[str, str], ...]] = {
    "bridge": (("", "hydro_bridge.serial.port.PortSettings"),),
    "sim": (("", "hydro_sim.simulation.realtime.SimSettings"), ("box.", "hydro_sim.box.box.BoxConfig")),
    "guard of bridge and sim": (("guard.", "hydro_bridge.safety.guard_settings.GuardSettings"),),
    "filter": (("", "hydro_filter.controller.loop_filter.LoopFilterSettings"),),
    "trainer": (
        ("", "hydro_policy.runs.run_directory.TrainingSettings"),
        ("task.", "hydro_policy.task.mdp.TaskSettings"),
        ("task.gains.", "hydro_policy.task.mdp.GainRange"),
        ("sac.", "hydro_policy.sac.settings.SacSettings"),
        ("exam.", "hydro_policy.task.cases.ExamSettings"),
        ("monitor.", "hydro_policy.supervision.monitor.MonitorSettings"),
    ),
}
"""Headings, and the settings that their executables declare as ROS parameters, with their prefixes."""


class _ParserFoundError(Exception):
    """Raised in the place of parsing: carries the parser that a command has built."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser


def _stop(parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
    raise _ParserFoundError(parser)


def executables(package: str) -> dict[str, str]:
    """Return a package's executables and the modules of their `main`, from its setup.py."""
    text = (ROOT / "src" / package / "setup.py").read_text(encoding="utf-8")
    return dict(re.findall(r'"(\w+) = hydro_core\.process\.startup:main_of\.([\w.]+)"', text))


def parser_of(module: str) -> argparse.ArgumentParser:
    """Return the parser that `main` of a module asks, without running anything beyond it."""
    main = importlib.import_module(module).main
    with patch.object(argparse.ArgumentParser, "parse_known_args", _stop), patch.object(sys, "argv", [module]):
        try:
            main()
        except _ParserFoundError as found:
            return found.parser
    raise RuntimeError(f"{module}.main parses no command line")


def option_rows(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Yield every option of a parser as it is written, and what it means."""
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction) or action.help is argparse.SUPPRESS:
            continue
        formatter = argparse.HelpFormatter(parser.prog)
        default = formatter._get_default_metavar_for_positional(action)
        if action.option_strings:
            default = formatter._get_default_metavar_for_optional(action)
        values = formatter._format_args(action, default) if action.nargs != 0 else ""
        names = action.option_strings or [values]
        written = ", ".join(f"{name} {values}".strip() if action.option_strings else name for name in names)
        meaning = (action.help or "") % {**vars(action), "prog": parser.prog}
        yield written, " ".join(meaning.split())


def paragraphs(text: str) -> Iterator[str]:
    """Yield the lines of a help text: what has examples as a block, everything else as prose."""
    for part in re.split(r"\n\s*\n", text.strip("\n")):
        lines = [line.rstrip() for line in part.splitlines()]
        if any(line.startswith((" ", "ros2 ")) for line in lines):
            yield from (f"    {line}" for line in lines)
        else:
            yield from textwrap.wrap(_escape(" ".join(lines)), WIDTH)
        yield ""


def command_text(name: str, module: str, earlier: dict[tuple[str, str], str]) -> str:
    """Return the section of one command. `earlier` has the rows of the commands before it, and gets its own."""
    parser = parser_of(module)
    summary, _, rest = (parser.description or "").strip().partition("\n\n")
    lines = [f"## {name}", "", *textwrap.wrap(" ".join(summary.split()), WIDTH), ""]
    if rest.strip():
        lines += paragraphs(rest)
    rows = list(option_rows(parser))
    repeated = Counter(earlier[row] for row in rows if row in earlier)
    others = [command for command, number in repeated.items() if number >= SHARED]
    if rows:
        lines += ["| option | meaning |", "|---|---|"]
        own = [(written, meaning) for written, meaning in rows if earlier.get((written, meaning)) not in others]
        lines += [f"| `{_cell(written)}` | {_escape(_cell(meaning))} |" for written, meaning in own]
        for command in others:
            same = ", ".join(f"`{row[0].split()[0]}`" for row in rows if earlier.get(row) == command)
            lines.append(f"| {same} | as for [{command}](#{command}) |")
        lines.append("")
    earlier |= {row: name for row in rows if row not in earlier}
    if parser.epilog:
        lines += paragraphs(parser.epilog)
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _escape(text: str) -> str:
    return text.replace("<", "&lt;").replace("*", "\\*")


def commands_page(package: str) -> str:
    """Return the page of a package's commands."""
    head = [f"# Commands of {package}", ""]
    head += [f"Each runs as `ros2 run {package} <command> [options]`.", ""]
    earlier: dict[tuple[str, str], str] = {}
    sections = [command_text(name, module, earlier) for name, module in sorted(executables(package).items())]
    return "\n".join([*head, *sections]).rstrip() + "\n"


def parameter_rows(prefix: str, settings: type[Any]) -> Iterator[str]:
    """Yield a table row for each field that a node declares as a parameter."""
    defaults = settings()
    for name, setting in describe(settings).items():
        value = getattr(defaults, name)
        if isinstance(value, (bool, int, float, str)):
            written = json.dumps(value) if isinstance(value, (bool, str)) else f"{value:.12g}"
            limits = setting.range or ", ".join(setting.choices)
            cells = (f"`{prefix}{name}`", f"`{written}`", setting.unit, limits, _escape(_cell(setting.meaning)))
            yield f"| {' | '.join(cells)} |"


def parameters_page() -> str:
    """Return the page of all ROS parameters."""
    lines = ["# ROS parameters", ""]
    lines += ["Set them behind `--ros-args`, for instance `-p guard.delta_kp_max:=50.0`. A parameter that a node does"]
    lines += ["not have, or a value outside of its range, ends the command with one sentence and exit status 2.", ""]
    for heading, groups in SETTINGS.items():
        lines += [f"## {heading}", "", "| parameter | default | unit | range | meaning |", "|---|---|---|---|---|"]
        for prefix, place in groups:
            module, _, name = place.rpartition(".")
            lines += parameter_rows(prefix, getattr(importlib.import_module(module), name))
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def messages_page() -> str:
    """Return the page of all messages and services, as their files define them."""
    lines = ["# Messages and services", "", "Package `hydro_msgs`; units stand beside the fields.", ""]
    source = ROOT / "src" / "hydro_msgs"
    for path in (*sorted(source.glob("msg/*.msg")), *sorted(source.glob("srv/*.srv"))):
        text = path.read_text(encoding="utf-8").rstrip()
        lines += [f"## {path.stem}", "", *(f"    {line}" for line in text.splitlines() if line), ""]
    return "\n".join(lines).rstrip() + "\n"


def effects_page() -> str:
    """Return the page of all effects: as the diagnosis names them, and as the emulator conceals them."""
    causes: dict[str, list[Any]] = {}
    for effect in importlib.import_module("hydro_diagnosis.effects").LIBRARY:
        causes.setdefault(effect.id, []).append(effect)
    truth = importlib.import_module("hydro_sim.emulator.truth.effects")
    emulated = {
        name: next(iter(re.findall(r"[A-Z]\w+", str(field.type))))
        for group in (truth.Effects, truth.UnnamedEffects)
        for name, field in group.__dataclass_fields__.items()
    }
    lines = [
        *("# Effects", ""),
        "What the diagnosis can name, and what the emulator's truth (`truth.yaml`) can conceal. Where one side is",
        *("empty, it lacks the effect: the diagnosis can then only say that something is missing.", ""),
    ]
    lines += ["| id | diagnosis: parameters | its options | emulator: keys | its forms |", "|---|---|---|---|---|"]
    for name in sorted({*causes, *emulated}):
        own = causes.get(name, [])
        parameters = {f"`{one.name}` [{one.unit}]": None for effect in own for one in effect.parameters if one.reported}
        options = [effect.label.partition(":")[2] for effect in own]
        keys = describe(getattr(truth, emulated[name])) if name in emulated else {}
        told = [f"`{key}`" for key, one in keys.items() if not one.choices]
        forms = [choice for one in keys.values() for choice in one.choices]
        cells = (
            f"`{name}`",
            ", ".join(parameters),
            ", ".join(filter(None, options)),
            ", ".join(told),
            ", ".join(forms),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def pages() -> dict[str, str]:
    """Return the text of every generated page, by its path below docs/."""
    found = {f"{REFERENCE}/commands/{package}.md": commands_page(package) for package in PACKAGES}
    others = {"parameters": parameters_page(), "messages": messages_page(), "effects": effects_page()}
    return {**found, **{f"{REFERENCE}/{name}.md": text for name, text in others.items()}}


if __name__ == "__main__":
    json.dump(pages(), sys.stdout)
