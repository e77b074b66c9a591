# SPDX-License-Identifier: Apache-2.0
"""Importers of files that are not bags, as named columns and single numbers; one module per format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_diagnosis.formats.delimited import delimited_columns
from hydro_diagnosis.formats.file_columns import Columns
from hydro_diagnosis.formats.hdf5 import hdf5_columns, is_hdf5
from hydro_diagnosis.formats.matlab import matlab_columns
from hydro_diagnosis.formats.mdf import mdf_columns
from hydro_diagnosis.formats.tdms import tdms_columns
from hydro_diagnosis.formats.units import in_name
from hydro_diagnosis.recording import InputError


def read_columns(path: Path) -> Columns:
    """Read a file.

    Raises
    ------
    InputError
        In one sentence that names the path.
    """
    try:
        found = _READERS[path.suffix.lower()](path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ImportError, OSError, ValueError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None
    if not found.series:
        raise InputError(f"{path}: there is no column of numbers in it")
    return found


def _parquet(path: Path) -> Columns:
    frame = pd.read_parquet(path)
    numbers = {str(name): pd.to_numeric(frame[name], errors="coerce") for name in frame.columns}
    kept = {name: values.to_numpy(dtype=np.float64) for name, values in numbers.items() if values.notna().any()}
    units = {name: unit for name in kept if (unit := in_name(name))}
    return Columns(kept, other=tuple(name for name in numbers if name not in kept), units=units)


def _mat(path: Path) -> Columns:
    """Read a .mat file; from MATLAB 7.3 on it is HDF5."""
    return hdf5_columns(path) if is_hdf5(path) else matlab_columns(path)


_READERS: dict[str, Callable[[Path], Columns]] = {
    ".csv": delimited_columns,
    ".txt": delimited_columns,
    ".tsv": delimited_columns,
    ".parquet": _parquet,
    ".pq": _parquet,
    ".mat": _mat,
    ".h5": hdf5_columns,
    ".hdf5": hdf5_columns,
    ".mf4": mdf_columns,
    ".mdf": mdf_columns,
    ".tdms": tdms_columns,
}
