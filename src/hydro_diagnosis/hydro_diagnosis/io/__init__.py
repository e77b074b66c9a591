# SPDX-License-Identifier: Apache-2.0
"""Columns as the bench's signals: column maps, proposals for them, clocks, tables, and what `inspect` lists.

May import `formats` and `recording`.
"""
