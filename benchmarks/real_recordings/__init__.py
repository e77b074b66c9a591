# SPDX-License-Identifier: Apache-2.0
"""Real recordings of public rigs (`rigs/*.yaml`), with answers that were obtained without this program."""
