# SPDX-License-Identifier: Apache-2.0
"""A model for what no name explains: held-out evidence chooses its terms, a forward simulation admits it.

May import `estimation`, `selection` and `validation`.
"""
