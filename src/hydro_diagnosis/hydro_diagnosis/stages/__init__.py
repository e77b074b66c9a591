# SPDX-License-Identifier: Apache-2.0
"""Stages of a diagnosis, in order: recordings are read, causes named, the rest modelled, everything reported."""
