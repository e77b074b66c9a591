# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring, naming and units, found before the diagnosis, with the column map that repairs each.

May import `io` and `preprocessing`.
"""
