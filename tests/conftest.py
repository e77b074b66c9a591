# SPDX-License-Identifier: Apache-2.0
"""What several files of whole-graph tests use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.graph_probe import Probe


@pytest.fixture
def probe() -> Iterator[Probe]:
    """A node that watches, in a domain of its own."""
    from tests.graph_probe import Probe, own_domain

    with own_domain():
        watcher = Probe()
        yield watcher
        watcher.close()
