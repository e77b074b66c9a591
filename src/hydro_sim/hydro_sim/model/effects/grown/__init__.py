# SPDX-License-Identifier: Apache-2.0
"""Grown effects: laws that `diagnose --grow` gave an id, one module each, in its `EFFECT`.

Modules are read from this folder, where a checkout keeps them under version control, and from the user's own: the
folder that the environment variable HYDRO_EFFECTS names, else `~/.local/share/hydro/effects`.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from hydro_bridge.errors import UserError
from hydro_sim.model.effects.closure import NamedLaw

VARIABLE = "HYDRO_EFFECTS"
HERE = Path(__file__).resolve().parent
_CHECKOUT = HERE.parents[3]
"""Of a checkout: src/hydro_sim, which holds package.xml."""


def users_folder() -> Path:
    """The user's folder of grown effects; it need not exist."""
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return Path(os.environ.get(VARIABLE) or data / "hydro" / "effects")


def folder() -> Path:
    """Where a new effect goes: this package in a checkout, unless HYDRO_EFFECTS says otherwise; else the user's."""
    in_checkout = (_CHECKOUT / "package.xml").is_file() and os.access(HERE, os.W_OK)
    return HERE if in_checkout and not os.environ.get(VARIABLE) else users_folder()


def tests_folder(effects: Path) -> Path:
    """Where the test of an effect in this folder goes: the diagnosis' tests in a checkout, else beside it."""
    return _CHECKOUT.parent / "hydro_diagnosis" / "test" if effects.resolve() == HERE else effects


def is_read(place: Path) -> bool:
    """Return whether bench files may name the effects in a folder."""
    return place.resolve() in (Path(one).resolve() for one in __path__)


def _read() -> tuple[NamedLaw, ...]:
    names = sorted({module.name for module in iter_modules(__path__) if not module.name.startswith("test_")})
    return tuple(map(_effect, names))


def _effect(name: str) -> NamedLaw:
    try:
        found = import_module(f"{__name__}.{name}").EFFECT
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise UserError(
            f"{_file(name)}: this grown effect cannot be read ({why}): mend the file or remove it"
        ) from error
    if not isinstance(found, NamedLaw):
        raise UserError(f"{_file(name)}: its EFFECT is no NamedLaw: mend the file or remove it")
    return found


def _file(name: str) -> Path:
    places = [Path(one) / name for one in __path__]
    found = [path for place in places for path in (place.with_suffix(".py"), place) if path.exists()]
    return found[0] if found else Path(name)


def sources() -> list[Path]:
    """Files of the effects."""
    return sorted(file for place in __path__ for file in Path(place).glob("*.py") if not file.name.startswith("test_"))


__path__.append(str(users_folder()))
EFFECTS: tuple[NamedLaw, ...] = _read()
"""Grown effects, by id."""
IDS = frozenset(one.id for one in EFFECTS)
