# SPDX-License-Identifier: Apache-2.0
"""Files for learning: recordings as runs, weights, and the box that each file belongs to.

May import `model`.
"""
