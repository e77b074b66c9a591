# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import signal

import pytest


def pytest_configure() -> None:
    """Take Ctrl-C as a terminal gives it: a shell's background job ignores it, and so would all that tests start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Where tests are shared out, then by file: a file's fixtures are made once. Graph tests stay together."""
    group = "graph" if item.get_closest_marker("graph") else item.path.name
    item.add_marker(pytest.mark.xdist_group(group))
