# SPDX-License-Identifier: Apache-2.0
"""Physics that the table of causes has no name for, alone and beside causes that it has, on a plant written apart.

Each half's kinds, and what counts as their right form, were fixed before their author had seen the diagnosis' grammar
of closures.

    kinds -> cases -> physics, foreign plant -> `diagnose` -> score
"""
