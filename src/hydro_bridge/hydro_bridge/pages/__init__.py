# SPDX-License-Identifier: Apache-2.0
"""Pages that people open from disk: one template engine, one style sheet, everything inside one file."""

from hydro_bridge.pages.render import data_uri, environment

__all__ = ["data_uri", "environment"]
