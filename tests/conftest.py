# SPDX-License-Identifier: Apache-2.0
"""What several files of whole-graph tests use; imported late, for tests where there is no ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest


@pytest.fixture
def probe(domain: None) -> Iterator[Any]:
    """A node that watches, in a domain of its own."""
    from tests.graph_probe import Probe

    watcher = Probe()
    yield watcher
    watcher.close()


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """An emulator with its filter that can be attacked, in a domain of its own."""
    from tests.attacks import Defended
    from tests.domains import own_domain

    with own_domain(), ExitStack() as stack:
        yield Defended(tmp_path_factory.mktemp("graph"), stack)
