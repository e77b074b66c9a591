# SPDX-License-Identifier: Apache-2.0
"""proof.html: the standards, the pictures and every failure on one self-contained page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.cli.console import Table
from hydro_diagnosis.report.page import STYLE

_CAPTIONS = {
    "confusion": "What was said about each cause that was concealed alone; numbers are cases, blue is their share.",
    "errors": "Error of the size of each cause that was concealed alone, against how large it was. The detection floor "
    "is the size at which evidence would just be enough, or from which on it is worth claiming.",
    "coverage": "95 % intervals that hold the truth, by cause (number of parameters), with Wilson's interval.",
    "held_out": "Held-out error: on the line, naming cost nothing against knowing the true structure.",
}


def write(path: Path, table: Table, pictures: Mapping[str, Path], failed: Sequence[Mapping[str, Any]],
          about: Mapping[str, str]) -> None:  # fmt: skip
    """Write the page; `about`: facts on the run, by name."""
    facts = "".join(f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in about.items())
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Proof on sealed cases</title>",
        f"<style>{STYLE}img{{max-width:100%}}</style></head><body><h1>Proof on sealed cases</h1>",
        f"<table class='quiet'>{facts}</table><section><h2>Standards</h2>{_table(table)}</section>",
        *(_picture(file, _CAPTIONS[what]) for what, file in pictures.items()),
        f"<section><h2>Failures</h2>{_failures(failed)}</section></body></html>",
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(key)}</th>" for key in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(str(row[key]))}</td>" for key in table.columns) + "</tr>" for row in table.rows
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def _picture(file: Path, caption: str) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    return (
        f"<section><img alt='{escape(caption)}' src='data:image/png;base64,{data}'><p>{escape(caption)}</p></section>"
    )


def _failures(failed: Sequence[Mapping[str, Any]]) -> str:
    if not failed:
        return "<p>None.</p>"
    rows = "".join(
        f"<tr><td>{escape(one['case'])}</td><td>{escape(one['kind'])}</td><td>{_flat(one['truth'])}</td>"
        f"<td>{escape(one['verdict'])}</td><td>{_flat(one['claimed'])} {escape(one['why'])}</td></tr>"
        for one in failed
    )
    head = "".join(f"<th>{key}</th>" for key in ("case", "kind", "concealed", "verdict", "claimed"))
    return f"<table><tr>{head}</tr>{rows}</table>"


def _flat(data: Mapping[str, Any]) -> str:
    return escape(yaml.safe_dump(_rounded(data), default_flow_style=True, width=10**6).strip()) if data else ""


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value
