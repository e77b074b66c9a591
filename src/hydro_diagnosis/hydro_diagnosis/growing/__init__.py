# SPDX-License-Identifier: Apache-2.0
"""Growing the table: a law that diagnoses found on several benches becomes a named effect.

`sightings` reads the law from the reports, compares its parameters and writes the effect.
"""
