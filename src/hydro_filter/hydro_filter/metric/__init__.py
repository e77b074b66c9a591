# SPDX-License-Identifier: Apache-2.0
"""Contraction metrics M: constant (Lyapunov) and gain-scheduled, and their design.

May import `model`.
"""
