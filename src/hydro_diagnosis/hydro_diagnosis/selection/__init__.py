# SPDX-License-Identifier: Apache-2.0
"""Selection of hypotheses: search, significance, localisation, constancy, verdict, summary of each effect."""
