# SPDX-License-Identifier: Apache-2.0
"""What each of many columns gains on held-out blocks beside a fit, in closed form, from products alone."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import FloatArray


def column_gains(own: FloatArray, cross: FloatArray, square: FloatArray, weight: FloatArray, count: FloatArray,
                 size: float) -> tuple[FloatArray, float]:  # fmt: skip
    """Held-out deviance gained by each term, and the deviance before, from products by fold and channel.

    The normal equations of the standing columns and one more are solved by its Schur complement.
    """
    many = square.shape[-1]
    before, after = np.zeros(len(weight)), np.zeros((len(weight), many))
    weighted = [np.einsum("fc...,c->f...", one, weight) for one in (own, cross, square)]
    together = [one.sum(axis=0) for one in weighted]
    for k in range(len(own)):
        a, b, d = (whole - one[k] for whole, one in zip(together, weighted, strict=True))
        inverse = np.linalg.pinv(a[1:, 1:], rcond=1e-10, hermitian=True) if len(a) > 1 else np.zeros((0, 0))
        alone = -inverse @ a[1:, 0]
        full = np.concatenate([[1.0], alone])
        before += np.einsum("i,cij,j->c", full, own[k], full)
        turned = inverse @ b[1:]
        rest = d - np.sum(b[1:] * turned, axis=0)
        left = b[0] + alone @ b[1:]
        amount = np.where(rest > 1e-9 * d, -left / np.maximum(rest, 1e-300), 0.0)
        theta = np.concatenate([np.ones((1, many)), alone[:, None] - turned * amount])
        after += np.einsum("im,cij,jm->cm", theta, own[k], theta)
        after += 2.0 * amount * np.einsum("im,cim->cm", theta, cross[k]) + amount**2 * square[k]

    def deviance(squares: FloatArray) -> FloatArray:
        places = (..., *(None for _ in range(squares.ndim - 1)))
        variance = np.maximum(squares / np.maximum(count, 1.0)[places], 1.0)
        return np.asarray(np.sum(count[places] * np.log(variance) + squares / variance, axis=0))

    reached = float(deviance(before * size))
    return reached - deviance(after * size), reached
