# SPDX-License-Identifier: Apache-2.0
"""Contraction metrics M: constant (Lyapunov), gain-scheduled and network, and how they are solved.

May import `model`.
"""
