# SPDX-License-Identifier: Apache-2.0
"""Utilities of all commands: progress bars, tables, one-sentence errors, the rules of --resume.

May import all of this package but `ros` and `nodes`; every command may import it.
"""
