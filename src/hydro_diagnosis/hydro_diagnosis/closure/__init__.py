# SPDX-License-Identifier: Apache-2.0
"""Closures model what no named cause explains: held-out evidence selects terms, a forward simulation admits them."""
