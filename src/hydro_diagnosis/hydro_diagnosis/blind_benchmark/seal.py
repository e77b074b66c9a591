# SPDX-License-Identifier: Apache-2.0
"""Sealed answers: written before anything is recorded, identified by their digest, opened after the diagnosis.

The digest covers the answers' canonical JSON, so the same command reproduces it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from hydro_bridge.cli.console import UserError
from hydro_diagnosis.blind_benchmark.cases import Case

ANSWERS, DIGEST = "answers.json", "answers.sha256"


def close(cases: Sequence[Case], folder: Path) -> str:
    """Write the answers into `folder`, readable by their owner alone; returns their SHA-256.

    Raises
    ------
    UserError
        The folder holds the seal of other cases.
    """
    content = json.dumps([case.to_mapping() for case in cases], sort_keys=True, indent=1).encode()
    digest = hashlib.sha256(content).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / DIGEST
    if kept.exists():
        if kept.read_text().split()[0] != digest:
            raise UserError(f"{folder.parent} holds other cases: choose another --out, or say the same words again")
        return digest
    (folder / ANSWERS).write_bytes(content)
    (folder / ANSWERS).chmod(0o400)
    kept.write_text(f"{digest}  {ANSWERS}\n", encoding="utf-8")  # as sha256sum -c reads it
    return digest


def opened(folder: Path, digest: str) -> list[Case]:
    """Return the answers, if they match the seal.

    Raises
    ------
    UserError
        They were changed since.
    """
    content = (folder / ANSWERS).read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise UserError(f"{folder / ANSWERS} was changed after it was sealed: its digest is not {digest}")
    return [Case.from_mapping(data) for data in json.loads(content)]
