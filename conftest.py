# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of all packages."""

from __future__ import annotations

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A graph test keeps real time: one that fails is run once more, and the report counts it as a rerun."""
    for item in items:
        if item.get_closest_marker("graph"):
            item.add_marker(pytest.mark.flaky(reruns=1))
