# SPDX-License-Identifier: Apache-2.0
"""Host side of the serial line: state machine, latencies, clock synchronisation."""
