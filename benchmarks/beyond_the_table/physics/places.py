# SPDX-License-Identifier: Apache-2.0
"""Numbers by which compiled code knows the kinds, and the state that is theirs."""

from __future__ import annotations

from benchmarks.beyond_the_table.kinds import NAMES
from benchmarks.foreign_truth.equations import SPOOL

MEMORY = SPOOL
"""The foreign plant's spool is not used (it follows at once): its state is the kind's."""
(DRAG, FRICTION_POSITION, VALVE_HYSTERESIS, VALVE_CURVE, LEAK_ORIFICE, HOSE, SPRING_HYSTERESIS, CELL_CREEP, SEAL,
 CUSHION, HEAT, SPOOL_RATE, TRANSITION, LEAK_BY_MOTION, MOUNT, CELL_CURVE,
 FRICTION_LAG, BORE_SCORE, SHEAR_THINNING, PORT_RELIEF, WORN_BORE, HOT_LEAK, ROD_FILM, SPOOL_STOP, NULL_WARMS,
 RETURN_FILTER, STOP_SPRING, REBOUND_DAMPER, LEAF_SPRING, CELL_PICKUP, GAUGE_WARMS,
 GAUGE_SNUBBER,
 GLAND_PRESSURE, LIP_FILM, ROD_BELLOWS, COLD_START, WEEPING_FITTING, BLOW_BY, FLOATING_RING, SILTED_EDGE, JET_FORCE,
 LOAD_NULL, SPECIMEN_DAMPING, GRIP_MASS, SPECIMEN_SOFTENS, CELL_BYPASS, GAUGE_LIMIT,
 ENCODER_PLAY) = range(len(NAMES))  # fmt: skip
