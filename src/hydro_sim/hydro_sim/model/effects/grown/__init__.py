# SPDX-License-Identifier: Apache-2.0
"""Grown effects: laws with an id assigned by `diagnose --grow`, one file each.

Content of `<id>.yaml`::

    law: {equation: motion, form: quadratic drag}      a row of `model.grammar`
    sentence: ...                                      for a person at the bench
    parameters:
      coefficient: {seen: 880.0, low: 0.0, high: 8890.0}

Files are read from this folder, where a checkout keeps them under version control, and from the user's own: the
folder that the environment variable HYDRO_EFFECTS names, else `~/.local/share/hydro/effects`.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import yaml

from hydro_core.errors import UserError
from hydro_sim.model import grammar
from hydro_sim.model.effects.closure import NamedLaw
from hydro_sim.model.laws import Law, ShapeParameter

FOLDER_VARIABLE = "HYDRO_EFFECTS"
PACKAGE_FOLDER = Path(__file__).resolve().parent
_CHECKOUT = PACKAGE_FOLDER.parents[3]
"""Package folder in a checkout: src/hydro_sim, with package.xml."""


def user_folder() -> Path:
    """Return the user's folder of grown effects, which may not exist."""
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return Path(os.environ.get(FOLDER_VARIABLE) or data / "hydro" / "effects")


def target_folder() -> Path:
    """Return the folder for a new effect: this package in a checkout without HYDRO_EFFECTS, else the user's."""
    in_checkout = (_CHECKOUT / "package.xml").is_file() and os.access(PACKAGE_FOLDER, os.W_OK)
    return PACKAGE_FOLDER if in_checkout and not os.environ.get(FOLDER_VARIABLE) else user_folder()


def is_searched(place: Path) -> bool:
    """Return whether bench files can use the effects of a folder."""
    return place.resolve() in (PACKAGE_FOLDER, user_folder().resolve())


def effect_files() -> list[Path]:
    """Return the files of all grown effects."""
    return sorted({path for place in (PACKAGE_FOLDER, user_folder()) for path in place.glob("*.yaml")})


def _effect(path: Path) -> NamedLaw:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        row, seen = content["law"], content["parameters"]
        law = grammar.FORMS[row["equation"], row["form"]]
        if not isinstance(law, Law):
            raise ValueError("a table of numbers is not an effect")
        shapes = tuple(
            ShapeParameter(one.name, one.unit, (float(seen[one.name]["seen"]),)) for one in law.shape_parameters
        )
        typical = abs(float(seen["coefficient"]["seen"]))
        return NamedLaw(
            id=path.stem,
            law=replace(law, typical=typical, sentence=str(content["sentence"]), shape_parameters=shapes),
            bounds={name: (float(one["low"]), float(one["high"])) for name, one in seen.items()},
        )
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise UserError(f"{path}: this grown effect cannot be read ({why}): fix the file or remove it") from error


EFFECTS: tuple[NamedLaw, ...] = tuple(map(_effect, effect_files()))
"""Grown effects, by id."""
EFFECT_IDS = frozenset(one.id for one in EFFECTS)
