# SPDX-License-Identifier: Apache-2.0
"""Template environment of a package, with the shell shared by all pages: `{% extends "shell.html" %}`."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


def environment(package: str, folder: str = "templates") -> Environment:
    """Return the environment with the templates in `folder` of a package and the shared ones.

    Text is escaped unless it is marked safe; an undefined name is an error, not empty text.

    Parameters
    ----------
    package
        Import name, for instance ``hydro_diagnosis``.
    folder
        Folder with ``.html`` templates.
    """
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, folder), PackageLoader("hydro_bridge", "pages/templates")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def data_uri(file: Path) -> str:
    """Return a PNG picture as text for an `img`; raises OSError."""
    return f"data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}"
