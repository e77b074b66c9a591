# SPDX-License-Identifier: Apache-2.0
"""Before a session: command-line options, the plant and the box they mean, companion processes, the width of the guard.

May import `graph`.
"""
