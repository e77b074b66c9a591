# SPDX-License-Identifier: Apache-2.0
"""Results of a diagnosis: report.html with its plots, and corrected.yaml.

May import all stages before it; `findings` holds report.json.
"""
