# SPDX-License-Identifier: Apache-2.0
"""Contraction metrics M: constant (Lyapunov), gain-scheduled and network, and their design.

May import `model`.
"""
