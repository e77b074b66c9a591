# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import signal

import pytest


def pytest_configure() -> None:
    """Take Ctrl-C as a terminal gives it: a shell's background job ignores it, and so would all that tests start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A graph test keeps real time: one that fails is run once more, and the report counts it as a rerun.

    They come last: by then what they run is compiled, and a fresh machine does not compile beside a graph.
    """
    items.sort(key=lambda item: item.get_closest_marker("graph") is not None)
    for item in items:
        if item.get_closest_marker("graph"):
            item.add_marker(pytest.mark.flaky(reruns=1))
