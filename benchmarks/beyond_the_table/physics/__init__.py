# SPDX-License-Identifier: Apache-2.0
"""What each kind does to the foreign plant, one module an equation (two for the motion); `rates` puts them together.

A module adds the term of its equation and has `memory_rate`, the rate of its kinds' own state (0 for all others).
"""
