# SPDX-License-Identifier: Apache-2.0
"""Export of a policy as a C header: ros2 run hydro_policy export_c --policy FILE --out policy_weights.h.

The header holds the weights, the normalization of observations and the gain range of a policy.safetensors;
firmware/hydro/policy.h computes the mean action from them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hydro_core.cli.console import command, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.task.mdp import ACTION_SIZE, GainRange, normalization
from hydro_sim.box.header import header_file, initializer, wrap_words


def header(policy: Policy, gains: GainRange, origin: str) -> str:
    """Return the header that defines `HYDRO_POLICY`; the last layer contains only the outputs of the mean."""
    weights = [*policy.weights[:-1], policy.weights[-1][:, :ACTION_SIZE]]
    biases = [*policy.biases[:-1], policy.biases[-1][:ACTION_SIZE]]
    arrays = []
    for k, pair in enumerate(zip(weights, biases, strict=True), 1):
        for name, array in zip(("HYDRO_POLICY_WEIGHT", "HYDRO_POLICY_BIAS"), pair, strict=True):
            numbers = wrap_words(f"{number!s}f" for number in np.asarray(array, np.float32).ravel())
            arrays.append(f"static const float {name}_{k}[{array.size}] = {{\n{numbers}}};\n")
    low, high = (gains.changes(np.full(ACTION_SIZE, end)) for end in (-1.0, 1.0))
    center, scale = normalization(policy.size)
    members = {
        "weight": [f"HYDRO_POLICY_WEIGHT_{k}" for k in (1, 2, 3)],
        "bias": [f"HYDRO_POLICY_BIAS_{k}" for k in (1, 2, 3)],
        "center": center, "scale": scale, "low": low, "high": high,
    }  # fmt: skip
    body = [
        f'#define HYDRO_POLICY_UNITS {policy.sizes[1]}\n#include "hydro/policy.h"\n',
        *arrays,
        f"static const hydro_policy HYDRO_POLICY = {initializer(members)};",
    ]
    return header_file("HYDRO_POLICY_WEIGHTS_H", origin, "\n".join(body))


@command(ValueError)
def main() -> None:
    """Entry point."""
    words = "Write a policy's weights for a box in C (firmware/hydro/policy.h)."
    parser = argparse.ArgumentParser(prog="export_c", description=words, allow_abbrev=False)
    parser.add_argument("--policy", type=Path, required=True, metavar="FILE", help="policy.safetensors of a run")
    parser.add_argument("--out", type=writable_file, required=True, metavar="FILE.h", help="header to write")
    options = parser.parse_args()
    policy, gains, _ = load_policy(options.policy)
    origin = f"Written by `ros2 run hydro_policy export_c` from {options.policy.name}."
    write_atomic(Path(options.out), header(policy, gains, origin).encode())
    print(
        f"{options.out}: {policy.sizes[1]} units twice, delta_kp {gains.delta_kp_min:g} to {gains.delta_kp_max:g} 1/s"
    )
