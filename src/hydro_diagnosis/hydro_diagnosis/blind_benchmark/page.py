# SPDX-License-Identifier: Apache-2.0
"""proof.html: the standards, the pictures and every failure on one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.cli.console import Table
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.pages import data_uri, environment

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
    made = environment("hydro_diagnosis", "blind_benchmark/templates")
    made.filters["flat"] = _flat
    page = made.get_template("proof.html").render(
        title="Proof on sealed cases",
        about=about,
        table=table,
        pictures=[(_CAPTIONS[what], data_uri(file)) for what, file in pictures.items()],
        failed=failed,
    )
    write_whole(path, page.encode())


def _flat(data: Mapping[str, Any]) -> str:
    return yaml.safe_dump(_rounded(data), default_flow_style=True, width=10**6).strip() if data else ""


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value
