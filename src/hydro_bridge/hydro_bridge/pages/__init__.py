# SPDX-License-Identifier: Apache-2.0
"""Pages that people open from disk: one template engine, one style sheet, everything inside one file."""

from hydro_bridge.pages.render import data_uri, environment
from hydro_bridge.pages.results import Section, results_page

__all__ = ["Section", "data_uri", "environment", "results_page"]
