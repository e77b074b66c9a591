# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis calibrate`: from which evidence on a claim is worth making.

Recordings in which nothing is missing are searched in full with the threshold at zero. The largest evidence that any
claim reaches on each of them is what choosing among all hypotheses makes of noise; the threshold must stand above it.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from joblib import Parallel, delayed

from hydro_bridge.console import Table, add_json_argument, command
from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.fit import fit
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.rehearse import rehearsal
from hydro_diagnosis.search import Search, SearchSettings, score
from hydro_sim.bench import Bench


def largest_evidence(bench: Bench, seed: int) -> tuple[float, float, str]:
    """Noise scale, largest evidence [BIC] of any claim on two recordings of a bench as believed, and the claim."""
    rng = np.random.default_rng(seed)
    noise = float(np.exp(rng.uniform(np.log(0.1), np.log(4.0))))
    segments: list[Segment] = []
    for k, waveform in enumerate(rng.permutation([Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP])[:2]):
        reference = ReferenceSignal(
            waveform=Waveform(int(waveform)),
            amplitude=float(rng.uniform(150.0, 300.0)),
            offset=float(rng.uniform(-40.0, 40.0)),
            frequency=float(rng.uniform(0.4, 1.0)),
        )
        gains = float(rng.uniform(30.0, 90.0)), float(rng.uniform(5.0, 15.0))
        recording = rehearsal(bench, reference, gains=gains, seconds=20.0, noise=noise, seed=seed * 10 + k)
        segments += recording.segments
    problem = Problem(segments, bench)
    library = [effect.adapted(bench) for effect in LIBRARY]
    outcome = Search(problem, library, SearchSettings(threshold=0.0)).run()
    if not outcome.fit.claims:
        return noise, 0.0, "none"
    gain = score(problem, fit(problem, ())) - score(problem, outcome.fit)
    return noise, gain, "+".join(claim.effect.label for claim in outcome.fit.claims)


@command()
def main() -> int:
    """Run the calibration and print the threshold it asks for."""
    options = argparse.ArgumentParser(prog="calibrate", description="Find the evidence that a claim needs.")
    options.add_argument("--bench", help="bench.yaml (default: the nominal bench)")
    options.add_argument("--runs", type=int, default=40, help="pairs of recordings with nothing missing")
    options.add_argument("--seed", type=int, default=0, help="of references, gains and noise")
    add_json_argument(options)
    chosen = options.parse_args(sys.argv[1:])
    bench = Bench.load(chosen.bench) if chosen.bench else Bench.nominal()
    found = Parallel(2)(delayed(largest_evidence)(bench, chosen.seed + k) for k in range(chosen.runs))
    table = Table(
        {"noise": "scale of the sensors' noise", "evidence": "largest, BIC", "claim": "what would be claimed"}
    )
    for noise, gain, label in found:
        table.add(noise=noise, evidence=gain, claim=label)
    table.show(chosen.json)
    gains = [gain for _, gain, _ in found]
    used = SearchSettings().threshold
    print(f"largest evidence in {len(gains)} runs: {max(gains):.1f}; the threshold in use is {used:g}")
    return 0


if __name__ == "__main__":
    main()
