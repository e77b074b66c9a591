# SPDX-License-Identifier: Apache-2.0
"""Utilities of all commands: progress bars, tables, one-sentence errors, the rules of --resume."""
