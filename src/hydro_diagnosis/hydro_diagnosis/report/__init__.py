# SPDX-License-Identifier: Apache-2.0
"""Results of a diagnosis: report.html with its plots, and corrected.yaml."""
