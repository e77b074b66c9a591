# SPDX-License-Identifier: Apache-2.0
"""Suffixes of readable files other than bags; `importers` has a reader for each."""

SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".mat", ".h5", ".hdf5", ".mf4", ".mdf", ".tdms")
