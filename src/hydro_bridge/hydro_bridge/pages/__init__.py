# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages: one template engine, one style sheet."""

from hydro_bridge.pages.render import data_uri, environment
from hydro_bridge.pages.results import Section, results_page

__all__ = ["Section", "data_uri", "environment", "results_page"]
