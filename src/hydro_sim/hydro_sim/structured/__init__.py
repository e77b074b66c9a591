# SPDX-License-Identifier: Apache-2.0
"""The structured model: textbook equations with learned constants, a network for the rest, an observer of its state.

May import `model`, `files` and `neural`.
"""
