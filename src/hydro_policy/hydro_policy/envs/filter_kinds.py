# SPDX-License-Identifier: Apache-2.0
"""Names of the filters available between policy and box of a simulated bench; `vector_filter` creates them."""

from __future__ import annotations

from typing import Literal, get_args

FilterName = Literal["none", "constant", "learned"]
FILTERS: tuple[FilterName, ...] = get_args(FilterName)
"""Kinds of filters by name."""
