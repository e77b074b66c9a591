# SPDX-License-Identifier: Apache-2.0
"""Files that learning reads and leaves: recordings as runs, weights, and what each was made for.

May import `model`.
"""
