# SPDX-License-Identifier: Apache-2.0
"""Stages of a diagnosis, in order: recordings are read, causes named, the remainder modelled, the report built."""
