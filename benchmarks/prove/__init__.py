# SPDX-License-Identifier: Apache-2.0
"""Proof on sealed cases: concealed causes are diagnosed blind and scored once the seal is opened."""
