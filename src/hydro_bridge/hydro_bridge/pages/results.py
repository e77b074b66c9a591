# SPDX-License-Identifier: Apache-2.0
"""A page of results: facts on the run, then sections with a sentence, a table, a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from hydro_bridge.pages.render import data_uri, environment


class Tabular(Protocol):
    """Rows of results: `hydro_bridge.cli.console.Table` is one."""

    title: str

    @property
    def columns(self) -> Mapping[str, str]:
        """Key of each column and what it means, with its unit."""

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """A value for each key."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """One heading and what stands below it; what is not given is left out."""

    heading: str
    text: str = ""
    table: Tabular | None = None
    picture: Path | None = None
    """A PNG; left out if it is not there."""


def results_page(title: str, about: Mapping[str, Any], sections: Sequence[Section]) -> str:
    """The page, self-contained.

    Parameters
    ----------
    title
        Its heading.
    about
        Facts on the run by name: plant, seed, filter, version of the code.
    sections
        In this order.

    Raises
    ------
    OSError
        A picture cannot be read.
    """
    made = environment("hydro_bridge", "pages/templates")
    made.filters["shown"] = _shown
    pictures = {
        section.heading: data_uri(section.picture)
        for section in sections
        if section.picture and section.picture.is_file()
    }
    return made.get_template("results.html").render(title=title, about=about, sections=sections, pictures=pictures)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
