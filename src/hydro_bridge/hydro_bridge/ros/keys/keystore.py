# SPDX-License-Identifier: Apache-2.0
"""Keystore made by the package sros2: keys, certificates and signed permissions of every enclave of a policy."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hydro_bridge.errors import UserError
from hydro_bridge.files.atomic import flush_folder

POLICY = "policy.xml"
_ONLY_OWNER = 0o077  # umask: whoever can read a key can act as its owner


def make_keystore(folder: Path, policy: bytes, enclaves: Iterable[str]) -> None:
    """Create `folder`, private to its owner, with keys and permissions for all enclaves of `policy`, or not at all.

    It is valid for the domain of ROS_DOMAIN_ID. The policy is stored beside the keys.

    Raises
    ------
    UserError
        The package sros2 is missing or refuses, or the folder exists.
    """
    try:
        from sros2 import errors, keystore
    except ImportError as error:
        raise UserError(
            f"keys are made by the package sros2, which is not here ({error}): apt install ros-jazzy-sros2, "
            "and source ROS 2; `secure --policy FILE` writes the policy without it"
        ) from None
    if folder.exists():
        raise UserError(f"{folder} is there already: name another folder, its keys will not know those of this one")
    domain()  # sros2 would copy any value unchecked
    with _growing(folder) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sros2's own, about its library calls
        (partial / POLICY).write_bytes(policy)
        try:
            keystore.create_keystore(partial)
            for enclave in enclaves:
                keystore.create_enclave(partial, enclave)  # permits everything until the policy is signed
                keystore.create_permission(partial, enclave, partial / POLICY)
        except (errors.SROS2Error, RuntimeError) as error:
            raise UserError(f"sros2 refuses: {error}") from None


def domain() -> int:
    """Return the domain that keys are made for: ROS_DOMAIN_ID, or 0.

    Raises
    ------
    UserError
        It is not a number that ROS accepts.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdecimal() and int(text) <= 232):
        raise UserError(f"ROS_DOMAIN_ID={text}: a number from 0 to 232 is meant")
    return int(text)


@contextmanager
def _growing(folder: Path) -> Iterator[Path]:
    """Yield a private temporary folder, renamed to `folder` on success and removed on failure."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    before = os.umask(_ONLY_OWNER)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield partial
        partial.rename(folder)
        flush_folder(folder.parent)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    finally:
        os.umask(before)
