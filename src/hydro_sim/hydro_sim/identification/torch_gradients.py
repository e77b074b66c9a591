# SPDX-License-Identifier: Apache-2.0
"""Loss and gradient of both structures in torch, for GPUs.

Written plainly, a line an equation: tests check the compiled gradients with it, benchmarks time it. Arrays in and out
are numpy's; torch computes in their precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from hydro_bridge.signals import FloatArray
from hydro_sim.model import equations as eq
from hydro_sim.neural import mlp
from hydro_sim.structured import integration, physics, rollout

P = {name: getattr(physics, name) for name in dir(physics) if name.isupper()}
"""Index of each constant by its name in `physics`."""


def _network(weights: list[Any], x: Any) -> Any:
    w1, b1, w2, b2, w3, b3 = weights
    return torch.relu(torch.relu(x @ w1 + b1) @ w2 + b2) @ w3 + b3


def _leaves(layers: mlp.Layers, device: str) -> list[Any]:
    return [torch.tensor(np.ascontiguousarray(view), device=device, requires_grad=True) for view in layers]


def _flat(leaves: list[Any]) -> FloatArray:
    return np.concatenate([leaf.grad.cpu().numpy().ravel() for leaf in leaves])


def network_loss(
    layers: mlp.Layers, step: Any, starts: Any, currents: Any, targets: Any, printed: bool, device: str = "cpu"
) -> tuple[float, FloatArray]:
    """Loss and gradient by the flat weights of the paper's model; shapes as in `network.loss_and_gradient`."""
    weights = _leaves(layers, device)
    z, scale, u, goal = (torch.tensor(part, device=device) for part in (starts, step, currents, targets))
    states = []
    for h in range(currents.shape[1]):
        z = z + scale * _network(weights, torch.cat((z, u[:, h : h + 1]), dim=1))
        states.append(z)
    error = torch.stack(states, dim=1) - goal
    loss = (error.sum(dim=1) ** 2).mean() if printed else (error**2).mean()
    loss.backward()
    return loss.item(), _flat(weights)


def _friction(c: Any, v: Any, z: Any) -> Any:
    level = c[P["COULOMB"]] + c[P["STRIBECK"]] * torch.exp(-((v / c[P["STRIBECK_VELOCITY"]]) ** 2))
    slip = v - c[P["BRISTLE"]] * v.abs() / level * z
    fading = torch.exp(-((v / c[P["DAMPING_VELOCITY"]]) ** 2))
    return c[P["BRISTLE"]] * z + c[P["BRISTLE_DAMPING"]] * fading * slip


def _root(drop: Any) -> Any:
    return drop / (drop**2 + physics.LAMINAR**2) ** 0.25


def _rates(c: Any, y: Any, z: Any, u: Any, r: Any) -> Any:
    a, b, x, v, spool, spool_rate, cell, cell_rate = y
    opening, leak = spool + c[P["OFFSET"]], c[P["LEAK"]] * (a - b)
    out, n = opening >= 0.0, physics.numbers(c)
    drops_out, drops_back = eq.edge_drops(c[P["SUPPLY"]], c[P["TANK"]], a, b)
    flow_a = opening * torch.where(
        out, c[P["KA_POSITIVE"]] * _root(drops_out[0]), c[P["KA_NEGATIVE"]] * _root(drops_back[0])
    )
    flow_b = opening * torch.where(
        out, c[P["KB_POSITIVE"]] * _root(drops_out[1]), c[P["KB_NEGATIVE"]] * _root(drops_back[1])
    )
    flows = flow_a * (1.0 + r[0]) - leak, leak - flow_b * (1.0 + r[1])
    spring = c[P["SPRING"]] * (x - c[P["REST"]])
    force = eq.hydraulic_force(n, a, b) - c[P["VISCOUS"]] * v - spring + r[2] - _friction(c, v, z)
    w, d = c[P["SPOOL_OMEGA"]], c[P["SPOOL_DAMPING"]]
    wl, dl = c[P["CELL_OMEGA"]], c[P["CELL_DAMPING"]]
    return (
        *eq.pressure_rates(n, physics.stiffnesses(c, x), flows, v),
        v, force / c[P["MASS"]], spool_rate, w * (w * (u - spool) - 2.0 * d * spool_rate),
        cell_rate, wl * (wl * (spring - cell) - 2.0 * dl * cell_rate),
    )  # fmt: skip


def _half_bristle(c: Any, z: Any, v: Any) -> Any:
    level = c[P["COULOMB"]] + c[P["STRIBECK"]] * torch.exp(-((v / c[P["STRIBECK_VELOCITY"]]) ** 2))
    decay = c[P["BRISTLE"]] * v.abs() * 0.5 * integration.STEP / level
    kept = torch.exp(-decay)
    filling = torch.where(decay < 1e-4, 1.0 - 0.5 * decay, (1.0 - kept) / torch.clamp(decay, min=1e-9))
    return z * kept + 0.5 * integration.STEP * v * filling


def _sample(c: Any, s: list[Any], u: Any, r: Any) -> list[Any]:
    step = integration.STEP
    for _ in range(integration.SUBSTEPS):
        y, z = s[:8], _half_bristle(c, s[8], s[3])
        k1 = _rates(c, y, z, u, r)
        k2 = _rates(c, [a + 0.5 * step * b for a, b in zip(y, k1, strict=True)], z, u, r)
        k3 = _rates(c, [a + 0.5 * step * b for a, b in zip(y, k2, strict=True)], z, u, r)
        k4 = _rates(c, [a + step * b for a, b in zip(y, k3, strict=True)], z, u, r)
        y = [a + step / 6.0 * (p + 2.0 * q + 2.0 * w + v) for a, p, q, w, v in zip(y, k1, k2, k3, k4, strict=True)]
        s = [*y, _half_bristle(c, z, y[3])]
    return s


def structured_loss(
    c: Any, layers: mlp.Layers, center: Any, scale: Any, starts: Any, currents: Any, targets: Any, weights: Any,
    device: str = "cpu",
) -> tuple[float, FloatArray, FloatArray]:  # fmt: skip
    """Loss and gradients by c and by the flat network; shapes as in `structured.loss_and_gradients`."""
    leaves, c = _leaves(layers, device), torch.tensor(c, device=device, requires_grad=True)
    u, goal, weight, middle, spread, gains = (
        torch.tensor(np.asarray(part), device=device)
        for part in (currents, targets, weights, center, scale, rollout.OUTPUT_SCALES)
    )
    s, readings = list(torch.tensor(starts, device=device).unbind(dim=1)), []
    for h in range(currents.shape[1]):
        x = (torch.stack(s[:5], dim=1) - middle) / spread
        s = _sample(c, s, u[:, h], (_network(leaves, x) * gains).unbind(dim=1))
        force = c[P["GAIN_H"]] * c[P["AREA"]] * (s[0] - c[P["RATIO"]] * s[1]) + c[P["BIAS_H"]]
        readings.append(torch.stack((force, c[P["GAIN_L"]] * s[6] + c[P["BIAS_L"]], s[0], s[1], s[2]), dim=1))
    loss = (((torch.stack(readings, dim=1) - goal) * weight) ** 2).sum(dim=2).mean()
    loss.backward()
    return loss.item(), c.grad.cpu().numpy(), _flat(leaves)
