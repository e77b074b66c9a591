# SPDX-License-Identifier: Apache-2.0
"""Templates of a package, with the shell that all pages share: `{% extends "shell.html" %}`."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


def environment(package: str, folder: str = "templates") -> Environment:
    """Templates in `folder` of a package, and the shared ones beside them.

    Text is escaped unless it is marked safe; a name that is not given is an error, not an empty place.

    Parameters
    ----------
    package
        Import name, for instance ``hydro_diagnosis``.
    folder
        With ``.html`` templates.
    """
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, folder), PackageLoader("hydro_bridge", "pages/templates")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def data_uri(file: Path) -> str:
    """A PNG picture as text for an `img`; raises OSError."""
    return f"data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}"
