# SPDX-License-Identifier: Apache-2.0
"""Contraction certificate, continuous (eq. cont_require_6) and sampled, and the QP for the smallest correction.

May import `model` and `metric`.
"""
