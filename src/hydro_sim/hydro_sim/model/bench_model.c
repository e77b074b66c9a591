// SPDX-License-Identifier: Apache-2.0
// A sample and its Jacobian: loops around what `hydro_sim.model.assembly` generates.
//
// Text of `bench_sample` and `bench_jacobian` is in a box, too (`source.embedded_source`).
//
// Above this text the generated part defines N (states), M (coefficients), P (parameters), SUBSTEPS, and
//   once(theta, k)                    begin(k, y, out)
//   enter(y, u, out)                  step(k, y, u, share, out)                read(k, y, z)
//   step_tangent(k, y, u, share, D, out, D_out)    read_tangent(k, y, D, z, Z)       D: N x (N + 1), by y and u
//   rates(k, y, u, share, out)

#include <string.h>

#define Z 5

// y and readings z after a sample at a held current u [A]; NaN, all of it, where one of the inputs is not finite:
// limits within the equations would hide that.
void bench_sample(const double *k, double *y, double u, double *z)
{
    double next[N], spoilt = 0.0 * u;
    for (int i = 0; i < N; i++)
        spoilt += 0.0 * y[i];
    enter(y, u, next);
    for (int i = 0; i < SUBSTEPS; i += 2) {
        step(k, next, u, (double)i / SUBSTEPS, y);
        step(k, y, u, (double)(i + 1) / SUBSTEPS, next);
    }
    for (int i = 0; i < N; i++)
        y[i] = next[i] + spoilt;
    read(k, y, z);
    for (int i = 0; i < Z; i++)
        z[i] += spoilt;
}

void bench_begin(const double *theta, double *k, double *y, double *z)
{
    double whole[N];
    once(theta, k);
    begin(k, y, whole);
    memcpy(y, whole, sizeof whole);
    read(k, y, z);
}

// z after each of n samples, n x 5.
void bench_rollout(const double *k, double *y, long n, const double *u, double *z)
{
    for (long h = 0; h < n; h++)
        bench_sample(k, y, u[h], z + Z * h);
}

// y at n samples of a record that gives its first four states, recorded n x 4: states n x N, whose others follow them.
void bench_hidden(const double *k, double *y, long n, const double *u, const double *recorded, double *states)
{
    double z[Z];
    for (long h = 0; h < n; h++) {
        memcpy(y, recorded + 4 * h, 4 * sizeof *y);
        memcpy(states + N * h, y, N * sizeof *y);
        bench_sample(k, y, u[h], z);
    }
}

// z at n samples of each window, windows x n x 5, from its state, y windows x N, and the currents from u[begins] on.
void bench_windows(const double *k, double *y, long windows, const long long *begins, long n, const double *u, double *z)
{
    double after[Z];
    for (long w = 0; w < windows; w++, y += N)
        for (long h = 0; h < n; h++, z += Z) {
            read(k, y, z);
            bench_sample(k, y, u[begins[w] + h], after);
        }
}

// y' at n samples: states n x N, currents n, rates n x RATES.
void bench_rates(const double *k, long n, const double *y, const double *u, double *slopes)
{
    for (long h = 0; h < n; h++)
        rates(k, y + N * h, u[h], 0.5, slopes + RATES * h);
}

const long bench_coefficients = M, bench_parameters = P, bench_states = N;

#ifdef DERIVATIVES

// As bench_sample; dy: d y / d (y, u), N x (N + 1); dz: d z / d (y, u), 5 x (N + 1). By rows.
void bench_jacobian(const double *k, double *y, double u, double *z, double *dy, double *dz)
{
    double next[N], moved[N * (N + 1)];
    for (int i = 0; i < N * (N + 1); i++)
        dy[i] = i % (N + 2) ? 0.0 : 1.0;
    enter(y, u, next);
    enter_tangent(dy, moved);
    memcpy(y, next, sizeof next);
    memcpy(dy, moved, sizeof moved);
    for (int i = 0; i < SUBSTEPS; i++) {
        step_tangent(k, y, u, (double)i / SUBSTEPS, dy, next, moved);
        memcpy(y, next, sizeof next);
        memcpy(dy, moved, sizeof moved);
    }
    read_tangent(k, y, dy, z, dz);
}

#endif
