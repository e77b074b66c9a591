# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages: one template engine, one style sheet, one shell: `{% extends "shell.html" %}`."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from hydro_core.cli.console import format_cell


def environment(package: str, folder: str = "templates") -> Environment:
    """Return the template environment of a package: the templates in its `folder`, and the shared ones.

    Text is escaped unless it is marked safe; an undefined name is an error, not empty text. `source(FILE)` is the text
    of a file of the folder as it is, the filter `base64` the encoding of bytes.

    `package`: import name, for instance ``hydro_diagnosis``. `folder`: folder with ``.html`` templates.
    """
    loader = PackageLoader(package, folder)
    made = Environment(
        loader=ChoiceLoader([loader, PackageLoader("hydro_bridge", "pages/templates")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["source"] = lambda file: loader.get_source(made, file)[0]
    made.filters["base64"] = lambda content: base64.b64encode(content).decode()
    made.filters["format_cell"] = format_cell
    return made


@dataclass(frozen=True, kw_only=True)
class Section:
    """Section of a page: heading and content; entries that are not given are omitted."""

    heading: str
    text: str = ""
    table: Any = None
    """A `hydro_core.cli.console.Table`."""
    picture: Path | None = None
    """PNG file; omitted if it does not exist."""


def results_page(title: str, about: Mapping[str, Any], sections: Sequence[Section]) -> str:
    """Return a results page as self-contained HTML.

    `title`: heading of the page. `about`: facts about the run by name: plant, seed, filter, version of the code.
    `sections`: sections in order. Raises OSError: a picture cannot be read.
    """
    page = environment("hydro_bridge", "pages/templates").get_template("results.html")
    return page.render(title=title, about=about, sections=sections)
