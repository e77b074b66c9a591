# SPDX-License-Identifier: Apache-2.0
"""The structured model: textbook equations with learned constants, a network for the residual, an observer.

May import `model`, `files` and `neural`.
"""
