# SPDX-License-Identifier: Apache-2.0
"""Networks as models of a bench: layers, rollouts and their gradients, compiled.

May import `model` and `files`.
"""
