# SPDX-License-Identifier: Apache-2.0
"""Model of a segment under hypotheses: chambers, forces, observer, residuals, noise floor, forward simulation.

May import `preprocessing` and `effects`.
"""
