# SPDX-License-Identifier: Apache-2.0
"""What to record next, where rivals cannot be told apart by the recordings at hand.

May import the stages before it, up to `selection`.
"""
