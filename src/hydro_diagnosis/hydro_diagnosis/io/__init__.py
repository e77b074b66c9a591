# SPDX-License-Identifier: Apache-2.0
"""Recordings as tables: bags, files of any logger, column maps, clocks, and what `inspect` lists."""
