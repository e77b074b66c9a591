# SPDX-License-Identifier: Apache-2.0
"""Which files that are not bags can be read, by their suffix. `importers` has a reader for each."""

SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".mat", ".h5", ".hdf5", ".mf4", ".mdf", ".tdms")
