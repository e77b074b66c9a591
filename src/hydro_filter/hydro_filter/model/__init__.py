# SPDX-License-Identifier: Apache-2.0
"""Model of the loop for the certificate: state, sample, exact Jacobians of bench and force law, loop coordinates.

May import `hydro_sim`; the rest of this package builds on it.
"""
