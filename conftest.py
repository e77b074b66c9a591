# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import signal

import pytest


def pytest_configure() -> None:
    """Take Ctrl-C as a terminal gives it: a shell's background job ignores it, and so would all that tests start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Graph tests run one after the other; the rest is shared out by file, so that fixtures are made once."""
    group = "graph" if item.get_closest_marker("graph") else item.path.name
    item.add_marker(pytest.mark.xdist_group(group))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Graph tests come first: they keep real time, and beside them computes the other worker."""
    items.sort(key=lambda item: item.get_closest_marker("graph") is None)
