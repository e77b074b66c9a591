# SPDX-License-Identifier: Apache-2.0
"""Preparation of a session: command-line options, the selected plant, companion processes, width of the guard.

May import `graph`.
"""
