# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring, naming and units, the column map that repairs each, and those that show in the numbers alone.

May import `io` and `preprocessing`.
"""
