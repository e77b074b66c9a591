# SPDX-License-Identifier: Apache-2.0
"""Commissioning of a bench: checks of its recordings, and the record of its gates."""
