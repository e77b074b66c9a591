# SPDX-License-Identifier: Apache-2.0
"""The benchmark control problem for real-time hybrid simulation, and entries that nobody here wrote beside our law.

Source: Silva, Gomez, Maghareh, Dyke, Spencer 2020, Mech. Syst. Signal Process. 135, 106381, and its public files.

    motions ──> plant (building, actuator, specimen) <── entries
                  │         simulation: RK4 at 4096 Hz
                  └──> criteria: J1 to J9
"""
