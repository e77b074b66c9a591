# SPDX-License-Identifier: Apache-2.0
"""ROS domains of tests: no two on this machine are one, so that no graph hears another test's nodes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from unittest.mock import patch

from domain_coordinator import domain_id

_TURNS = count(os.getpid())
"""A process takes another domain each time: what ended late in the last one is not heard in the next."""


@contextmanager
def reserved_domain() -> Iterator[str]:
    """A ROS domain that nobody else on this machine has who asks as we do.

    It is from 1 to 100: domains above 101 use ports that the kernel hands out to anybody.
    """
    with domain_id(lambda: 1 + next(_TURNS) % 100) as domain:
        yield str(domain)


@contextmanager
def own_domain() -> Iterator[None]:
    """Nodes and processes that begin within it have a domain of their own, on this machine only.

    Call `restrict_to_localhost` before: the range LOCALHOST would give a test's nodes shared memory (decision 0059).
    """
    with reserved_domain() as domain, patch.dict(os.environ, {"ROS_DOMAIN_ID": domain}):
        yield
