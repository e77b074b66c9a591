# SPDX-License-Identifier: Apache-2.0
"""Model of the loop for the certificate: state, sample, loop coordinates, and the records of the C.

May import `hydro_sim`; the rest of this package builds on it.
"""
