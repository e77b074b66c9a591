# SPDX-License-Identifier: Apache-2.0
"""Files of any logger as named columns with units: text, HDF5, MATLAB, MDF, TDMS, bags of other graphs.

May import `recording` for its errors; the first stage of a diagnosis.
"""
