# SPDX-License-Identifier: Apache-2.0
"""Selection of hypotheses: stepwise search for causes, and localisation of the mismatch."""
