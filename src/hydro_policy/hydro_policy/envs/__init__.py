# SPDX-License-Identifier: Apache-2.0
"""The task on many benches in parallel: vectorised box, plant and filter, domain randomisation."""

from __future__ import annotations

from typing import Literal, get_args

FilterName = Literal["none", "learned"]
FILTERS: tuple[FilterName, ...] = get_args(FilterName)
"""Names of the filters between policy and box of a simulated bench; `vector_env.vector_filter` creates them."""
