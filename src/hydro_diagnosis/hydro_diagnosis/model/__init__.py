# SPDX-License-Identifier: Apache-2.0
"""Model of a segment under hypotheses: chambers, forces, observer, residuals, forward simulation."""
