# SPDX-License-Identifier: Apache-2.0
"""The kinds of physics outside the table: those that improvements may look at, and then the sealed ones."""

from __future__ import annotations

from benchmarks.beyond_the_table.kind import Kind
from benchmarks.beyond_the_table.opened import OPENED
from benchmarks.beyond_the_table.sealed import SEALED

__all__ = ["HALVES", "KINDS", "NAMES", "Kind"]

KINDS: tuple[Kind, ...] = (*OPENED, *SEALED)
NAMES = tuple(kind.name for kind in KINDS)
"""Compiled code knows a kind by its place here; -1 is none."""
HALVES = ("dev", "sealed")
