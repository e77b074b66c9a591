# SPDX-License-Identifier: Apache-2.0
"""Identification of a bench from recordings: objectives, optimisers, start states, evaluation, `learn` and `validate`.

May import all of this package but `simulation`, `emulator` and `nodes`.
"""
