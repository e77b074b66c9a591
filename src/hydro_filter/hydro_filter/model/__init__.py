# SPDX-License-Identifier: Apache-2.0
"""The loop as the certificate sees it: state, sample, exact Jacobians of bench and force law, loop coordinates.

May import `hydro_sim`; everything else of this package stands on it.
"""
