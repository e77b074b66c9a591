# SPDX-License-Identifier: Apache-2.0
"""A segment of a recording under hypotheses: chambers, forces, observer, residuals, noise floor, forward simulation.

May import `preprocessing` and `effects`.
"""
