# SPDX-License-Identifier: Apache-2.0
"""Prove a certified region's file, with numpy alone: python -m benchmarks.verify_region FILE; status 1: not proved.

From the bench's equations (physics.md) and the force law. Coordinates: f_h, z = g s, z', f_l, f_l', x, x', x' of the
box, currents within a dead time; s: opening, g: N/s per A as the sample begins. Numbers are intervals, rounded outward;
matrices are C + sum s_i G_i + E, |s_i| <= 1, |E| <= R; the sample is the series of time-ordered products. The
inequality is convex in the matrix: it is asked at every vertex, with room for E.
"""

# ruff: noqa
# fmt: off
import json, math, sys
from itertools import pairwise, product
from pathlib import Path
import numpy as np

EPS, TERMS, SYMBOLS = 2.0**-52, 34, 14
C_LAW, ZETA, CHI, GAIN, FLOW, FLOW_ERROR, ETA, ETA_LAW, MEAN, DRIFT, SPRING, SPOOL, DELAY, SHARE = range(SYMBOLS)
down, up = lambda v: float(np.nextafter(v, -np.inf)), lambda v: float(np.nextafter(v, np.inf))
class I:  # an interval
    def __init__(self, low, high=None):
        self.low, self.high = float(low), float(low if high is None else high)
    def __mul__(self, other):
        found = [i * j for i, j in product((self.low, self.high), (of(other).low, of(other).high))]
        return I(down(min(found)), up(max(found)))
    def __rtruediv__(self, other):
        if self.low <= 0.0 <= self.high: raise ZeroDivisionError("a divisor in the bench's equations can be 0")
        return I(down(1.0 / self.high), up(1.0 / self.low)) * other
    __add__ = __radd__ = lambda self, other: I(down(self.low + of(other).low), up(self.high + of(other).high))
    __rmul__, size = __mul__, property(lambda self: max(abs(self.low), abs(self.high)))
    __neg__, __sub__, __rsub__ = lambda self: I(-self.high, -self.low), lambda s, o: s + (-o), lambda s, o: o + (-s)
    __truediv__ = lambda self, other: self * (1.0 / of(other))
    sqrt = lambda self: I(max(down(math.sqrt(self.low)), 0.0), up(math.sqrt(self.high)))
of, hull = lambda v: v if isinstance(v, I) else I(v), lambda *v: I(min(i.low for i in v), max(i.high for i in v))
class M:  # a set of matrices: s holds C, then G of each symbol; r: R
    def __init__(self, rows, columns, s=None, r=None):
        self.s = np.zeros((1 + SYMBOLS, rows, columns)) if s is None else s
        self.r = 0 * self.s[0] if r is None else r
    size = property(lambda self: np.abs(self.s).sum(0) * (1 + 1e-12) + self.r)
    def __add__(self, o):
        return M(0, 0, self.s + o.s, (self.r + o.r + 20 * EPS * (self.size + o.size)) * (1 + 1e-12))
    def __matmul__(self, o):
        s = self.s @ o.s[0]
        s[1:] += self.s[0] @ o.s[1:]
        r = self.size @ o.r + self.r @ np.abs(o.s).sum(0) + np.abs(self.s[1:]).sum(0) @ np.abs(o.s[1:]).sum(0)
        return M(0, 0, s, (r + 100 * EPS * self.size @ o.size) * (1 + 1e-12))
    __mul__ = lambda self, k: M(0, 0, self.s * k, (self.r + 4 * EPS * self.size) * abs(k))
    cut = lambda self, i, j: M(0, 0, self.s[:, i][:, :, j], self.r[i][:, j])
    def put(self, i, j, o):
        at = slice(i, i + o.r.shape[0]), slice(j, j + o.r.shape[1])
        self.s[:, at[0], at[1]], self.r[at] = o.s, o.r
def num(x, symbol=None):  # a number whose range is a symbol's, or a radius
    x, out = of(x), M(1, 1)
    out.s[0, 0, 0] = middle = 0.5 * (x.low + x.high)
    half = 0.0 if x.low == x.high else max(x.high - middle, middle - x.low) * (1 + 1e-14) + 4 * EPS * abs(middle)
    (out.r if symbol is None else out.s[1 + symbol])[0, 0] = half
    return out
def series(rates, apart, reach, whole):  # transitions by rates within `apart` of their mean, over a part of T
    n, spread = len(apart), M(*apart.shape)
    spread.s[:, range(n), range(n)], spread.r[range(n), range(n)] = reach.s[:, 0], reach.r[0]
    rates, apart, total, term, single = rates @ spread, apart * reach.size[0, 0], M(n, n), M(n, n), 0.0 * apart
    size, total.s[0], term.s[0], plain, every = rates.size, *[np.eye(n)] * 4
    for k in range(1, TERMS + 1):
        term, single = (term @ rates) * (1 / k), (single @ size + plain @ apart) / k
        plain, every, total = plain @ size / k, every @ (size + apart) / k, total + term
        # with mean 0 and a slope of 2 |E|/T a term with one E counts (k - 1)/(k + 1) of its size
        total.r += (1 + 1e-9) * ((k - 1) / (k + 1) if whole else 1) * single
        total.r += np.maximum(every - plain - single, 0) + 1e-14 * every
    norm = (size + apart).sum(1).max()
    total.r += 1.01 * norm ** (TERMS + 1) / math.factorial(TERMS + 1) / (1 - norm / (TERMS + 2))
    return total

def sample(D, tolerances, side, gain):  # [F + G K, disturbances], of the file D
    T, b, law, w, S, AB = D["period"], D["bench"], D["believed"], D["disturbances"], D["scale"], (0, 1)
    st, t = ({k: I(*v) for k, v in one.items()} for one in (D["states"], tolerances))
    area, x, v = (b["piston_area"], b["piston_area"] * b["area_ratio"]), st["position"], st["velocity"]
    dead, travel = [f"dead_volume_{c}" for c in "ab"], (x, b["stroke"] - x)
    v_law, own = [law[dead[j]] + area[j] * travel[j] for j in AB], [t[dead[j]] * b[dead[j]] for j in AB]
    vol, beta = [own[j] + area[j] * travel[j] for j in AB], t["bulk_modulus"] * b["bulk_modulus"]
    kv, ps, fed = t["valve_gain"] * b["valve_gain"], t["supply_pressure"] * b["supply_pressure"], 0 if side > 0 else 1
    p, tank, ps_law = (st["pressure_a"], st["pressure_b"]), b["tank_pressure"], law["supply_pressure"]
    drop, known = ([s - p[j] if j == fed else p[j] - tank for j in AB] for s in (ps, ps_law))
    q = [(1 + (ps - ps_law) / known[j]).sqrt() if j == fed else I(1) for j in AB]  # roots of drops over the law's
    more = [1 + (law[dead[j]] - own[j]) / vol[j] for j in AB]
    ratio, kappa = (t[name] * (b[name] / law[name]) for name in ("bulk_modulus", "valve_gain"))
    rho, mu = [ratio * m for m in more], more[1] / more[0]
    c, c_law = ([u * area[j] ** 2 / volume[j] for j in AB] for u, volume in ((beta, vol), (law["bulk_modulus"], v_law)))
    alpha, rate = area[1] / area[0], [area[j] * st[f"pressure_{'ab'[j]}_rate"] for j in AB]
    sigma, sigma_law = (1 / (1 + alpha**2 * (u[0] / u[1])) for u in (vol, v_law))
    phi, chis = 1 / (1 + alpha * ((known[1] / known[0]).sqrt() * (v_law[0] / v_law[1]))), []
    for f, i, j, s, m in product(*((one.low, one.high) for one in (phi, *q, sigma_law, mu))):
        chis.append((I(f) * i + (1 - I(f)) * (I(j) * m)) / (I(s) + (1 - I(s)) * m))  # monotone in each
    swept, core = T * v.size * max((area[j] / vol[j]).high for j in AB), more[0] * (1 + (1 - sigma_law) * (mu - 1))
    chi, zeta, core = kappa * hull(*chis) * I(1 - swept, 1 + swept), ratio * core, hull(*chis) * core  # core: see a
    error, share, late = st["opening_error"].size, I(*D["velocity_compensation"]), st["velocity_error"]
    most, wrong = max(st["opening"].high if side > 0 else -st["opening"].low, 0.0), I(-error, error)
    slope, leak = [beta / vol[j] * kv / (2 * drop[j].sqrt()) for j in AB], [beta / vol[j] * b["leakage"] for j in AB]
    per, back, a = slope[0] * sigma + slope[1] * (1 - sigma), [q[j] / more[j] for j in AB], kappa * ratio * core
    same = core * (back[1] + 1 / (1 + slope[1] / slope[0] * (alpha**2 * (vol[0] / vol[1]))) * (back[0] - back[1]))
    leaks = (leak[0] + leak[1] * alpha) * sigma + (leak[1] + leak[0] / alpha) * (1 - sigma)
    across, told, g = b["leakage"] * (p[0] - p[1]), I(0), [beta * area[j] / vol[j] * kv * drop[j].sqrt() for j in AB]
    for j, s in ((0, 1), (1, -1)):  # what the law takes for the chamber's share of f_h', by x
        i = 1 / (kappa * rho[j] * q[j])
        one = i * (rate[j] + s * (beta * area[j] / vol[j] * across) + g[j] * wrong)
        told += area[j] / v_law[j] * (one + s * (c[j] * v * (i - share / rho[j]) - share * c_law[j] * late))
    eta, drift = area[0] / vol[0] * rate[0] + area[1] / vol[1] * rate[1], T * st["gain_drift"]
    drift = hull(I(0), I(math.expm1(drift.low) * (1 + 1e-9), math.expm1(drift.high) * (1 + 1e-9)))
    one, stiff = num(1), num(c_law[0] + c_law[1], C_LAW) @ num(zeta, ZETA)
    k, om = (t[i] * (unit * b[i]) for i, unit in (("spring_stiffness", 1.0), ("spool_bandwidth", 2 * math.pi)))
    k, om = num(k, SPRING), num(om, SPOOL)
    flow, grown, later = num(per * I(0, most), FLOW), one + num(0.5005 * drift, MEAN), one + num(drift, DRIFT)
    m, wc, n, width, rates = b["moving_mass"], 2 * math.pi * b["cell_bandwidth"], len(S), len(S) + 4, M(10, 10)
    far_nu = per.high * (0.5 * T * st["opening_rate"].size + drift.size * most)
    unit, apart = [*S[:7], S[1], 1, S[1]], 0 * rates.r
    for i, j, entry, far in (  # seven states; the current, a force, an opening
        (0, 0, (flow + num(leaks)) * -1, far_nu), (0, 1, grown, 0.51 * drift.size), (0, 9, grown, 0), (1, 2, one, 0),
        (0, 5, num(eta, ETA) * -1, 4 * eta.size), (0, 6, stiff * -1, (c[0] + c[1]).high * swept), (2, 7, om @ om, 0),
        (2, 1, om @ om * -1, 0), (2, 2, om * (-2 * b["spool_damping"]), 0), (3, 4, one, 0), (4, 3, one * -(wc**2), 0),
        (4, 4, one * (-2 * b["cell_damping"] * wc), 0), (4, 5, k * wc**2, 0), (5, 6, one, 0), (6, 0, one * (1 / m), 0),
        (6, 5, k * (-1 / m), 0), (6, 6, one * (-b["viscous_friction"] / m), 0), (6, 8, one * (1 / m), 0),
    ):
        rates.put(i, j, entry * (T * unit[j] / unit[i]))
        apart[i, j] = far * T * unit[j] / unit[i]
    full, K, out, body, ways = series(rates, apart, one, True), M(1, width), M(n, width), M(7, width), n - 8
    mid, other_nu = 0.5 * (same.low + same.high), same * (per * wrong + I(-far_nu, far_nu))
    K.put(0, 0, (flow * mid + num((same - mid) * (per * I(0, most)) + other_nu, FLOW_ERROR)) * (S[0] / S[1]))
    K.put(0, 3, num(chi, CHI) @ num(zeta, ZETA) @ num(gain, GAIN) * (-S[3] / S[1]))
    for j, entry in {5: num(a * told, ETA_LAW), 7: num(share, SHARE) @ num(chi, CHI) @ stiff}.items():
        K.put(0, j, entry * (S[j] / S[1]))
    noise = a * (gain.size * w["force_noise"]) + (most + error * same) * per * (2 * w["pressure_noise"] * area[0])
    K.s[0, 0, n + 1] = noise.size / S[1]
    rows, pushed = [K, *(M(1, width) for _ in range(ways))], full.cut(range(7), [7])
    body.put(0, 0, full.cut(range(7), range(7)))
    for i in range(ways): rows[i + 1].s[0, 0, 8 + i] = 1
    drive = pushed @ K
    if ways:
        fresh = series(rates, apart, num((T * ways - t["dead_time"]) / T, DELAY), False).cut(range(7), [7])
        drive = fresh @ rows[ways - 1] + (pushed + fresh * -1) @ rows[ways]
    body = body + drive
    for j, i, strength in ((n, 8, w["friction"]), (n + 3, 9, (g[0] + g[1]).high * w["overlap"] / S[1])):
        body.put(0, j, full.cut(range(7), [i]) * strength)
    out.put(0, 0, body)
    body.s[0, 5, 5], memory = body.s[0, 5, 5] - 1, b["velocity_memory"]  # x' of the box: of what x moves by
    seen = body.cut([5], range(width)) * ((1 - memory) / T * S[5] / S[7])
    seen.s[0, 0, 7], seen.s[0, 0, n + 2] = seen.s[0, 0, 7] + memory, w["velocity_noise"] / S[7]
    moved = {1: body.cut([1], range(width)), 2: body.cut([2], range(width)), **{8 + i: rows[i] for i in range(ways)}}
    for i, row in {7: seen, **{i: later @ row for i, row in moved.items()}}.items():
        out.put(i, 0, row)
    return out

def holds(D, before, after, H):  # whether the norm of M+^1/2 (H + E) D^-1/2 is below 1 at every vertex
    n, decay, used = len(before), math.exp(-2 * D["tube_rate"] * D["period"]), np.flatnonzero(D["weights"]).tolist()
    bound = np.diag([0.0] * n + [(1 - decay) * D["weights"][i] * (1 - 1e-9) for i in used])
    bound[:n, :n] = before * decay * (1 - 1e-14)
    left, right = np.linalg.cholesky(after).T, np.linalg.inv(np.linalg.cholesky(bound).T)
    H = H.cut(range(n), [*range(n), *(n + i for i in used)])
    kept = np.abs(H.s[1:]).sum((1, 2)) > 1e-7
    radius, slopes, norm = H.r + np.abs(H.s[1:][~kept]).sum(0), list(H.s[1:][kept]), np.linalg.norm
    for _ in range(2):  # the largest entries of R become symbols
        largest = radius == radius[:, :n].max()
        slopes.append(np.where(largest, radius, 0.0))
        radius = np.where(largest, 0.0, radius)
    lost, big = norm(abs(left) @ radius @ abs(right)), abs(right.T) @ H.size.T
    lost += 200 * EPS * norm(abs(right.T) @ abs(bound) @ abs(right))
    lost += 200 * EPS * norm(big @ (abs(after) + abs(left.T) @ abs(left)) @ big.T)
    signs = np.array(list(product((-1.0, 1.0), repeat=len(slopes))))
    whole = left @ (H.s[0] @ right + np.tensordot(signs, np.array(slopes) @ right, 1))
    # the error of an eigenvalue is far below the 1e-8, which is for the rounding of plain numbers too
    return lost < 1 and (np.linalg.eigvalsh(whole.transpose(0, 2, 1) @ whole)[:, -1] < (1 - lost) ** 2 - 1e-8).all()

def verify(D, parts=6):
    """Return why the statement of a file's content is not proved, in a sentence; empty: it is."""
    tol, cells = D["tolerances"], D["cells"]
    edges = {k: sorted({e for one in cells for e in one["tolerances"][k]}) for k in tol}
    low, high = (np.array([[one["tolerances"][k][i] for k in tol] for one in cells]) for i in (0, 1))
    for middle in product(*([0.5 * (i + j) for i, j in pairwise(e)] or e for e in edges.values())):
        if not ((low <= middle) & (middle <= high)).all(axis=1).any():
            return "a part of the tolerances has no metric"
    sane = sum(D["weights"]) <= 1 and 0 < D["contraction_rate"] <= D["tube_rate"]
    if not sane or any([e[0], e[-1]] != list(tol[k]) for k, e in edges.items()):
        return "tolerances, weights or lambda are not those of the proof"
    for one in cells:
        gains, step = one["gains"], D["gain_rate"] * D["period"]
        table = [0.5 * (np.array(m) + np.array(m).T) for m in one["matrices"]]
        if [gains[0], gains[-1]] != list(D["proportional_gain"]) or sorted(set(gains)) != list(gains):
            return "the metric's gains are not those of the statement"
        if D["tube"] < D["scale"][3] * math.sqrt(max(np.linalg.inv(m)[3, 3] for m in table)) * (1 - 1e-9):
            return "the tube is narrower than what is proved"
        M_at = lambda k: np.tensordot([np.interp(k, gains, hat) for hat in np.eye(len(gains))], table, 1)
        for g, h in (ends for pair in pairwise(gains) for ends in pairwise(np.linspace(*pair, parts + 1))):
            slope, moves = (M_at(h) - M_at(g)) / (h - g), (step, -step) if step else (0.0,)
            pairs = [(M_at(k), other) for k in (g, h) for s in moves for other in (M_at(k) + s * slope, M_at(k + s))]
            for H in (sample(D, one["tolerances"], side, I(g, h)) for side in (1, -1)):
                if not all(holds(D, *pair, H) for pair in pairs):
                    return f"the metric is not proved to decay at K_p = {g:g} to {h:g} 1/s"
    return ""

if __name__ == "__main__":
    print(reason := verify(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))) or "proved")
    sys.exit(reason != "proved")
