// SPDX-License-Identifier: Apache-2.0
// Sensitivities of a prediction by any number of directions, and the extended Kalman filter that starts one.
//
// Beside what bench_model.c needs, the generated part defines HELD (states without past currents) and
//   once_partials(theta, k, partials)   step_partials(k, y, u, share, out, partials)   read_partials(k, y, z, partials)
// and, for each, how many partial derivatives there are, their ROWs and their COLUMNs: by the HELD states, then by the
// M coefficients. What is not listed is always 0.

// out (rows x p) = partial derivatives times directions (HELD + M rows, p columns).
static void moved(const double *partials, const short *row, const short *column, long count, const double *directions,
                  long rows, long p, double *restrict out)
{
    memset(out, 0, rows * p * sizeof *out);
    for (long i = 0; i < count; i++) {
        const double by = partials[i], *from = directions + column[i] * p;
        double *restrict to = out + row[i] * p;
        for (long j = 0; j < p; j++)
            to[j] += by * from[j];
    }
}

// k (M) and dk: d k / d theta, M x P.
void bench_once_partials(const double *theta, double *k, double *dk)
{
    double partials[ONCE_PARTIALS];
    once_partials(theta, k, partials);
    memset(dk, 0, M * P * sizeof *dk);
    for (int i = 0; i < ONCE_PARTIALS; i++)
        dk[ONCE_ROW[i] * P + ONCE_COLUMN[i]] = partials[i];
}

// y after a sample, and its first HELD rows of directions; `room`: HELD x p.
static void sample_moved(const double *k, double *y, double u, long p, double *directions, double *room)
{
    double next[N], partials[STEP_PARTIALS];
    enter(y, u, next);
    memcpy(y, next, sizeof next);
    for (int i = 0; i < SUBSTEPS; i++) {
        step_partials(k, y, u, i / (double)SUBSTEPS, next, partials);
        moved(partials, STEP_ROW, STEP_COLUMN, STEP_PARTIALS, directions, HELD, p, room);
        memcpy(directions, room, HELD * p * sizeof *room);
        memcpy(y, next, sizeof next);
    }
}

// Readings z (n x 5) after each of n samples and dz (n x 5 x p) along directions ((HELD + M) x p: of y, then of k).
// y and the directions move on in place. `room`: HELD x p.
void bench_sensitivities(const double *k, double *y, long n, const double *u, long p, double *directions, double *z,
                         double *dz, double *room)
{
    double partials[READ_PARTIALS];
    for (long h = 0; h < n; h++) {
        sample_moved(k, y, u[h], p, directions, room);
        read_partials(k, y, z + Z * h, partials);
        moved(partials, READ_ROW, READ_COLUMN, READ_PARTIALS, directions, Z, p, dz + Z * p * h);
    }
}

// Take in five readings, one after the other, for their noises (variances r) are independent. cov: HELD x HELD.
static void correct(const double *k, double *y, double *cov, const double *reading, const double *r)
{
    double z[Z], partials[READ_PARTIALS], row[Z][HELD] = {{0.0}}, change[HELD] = {0.0}, ph[HELD];
    read_partials(k, y, z, partials);
    for (int i = 0; i < READ_PARTIALS; i++)
        if (READ_COLUMN[i] < HELD)
            row[READ_ROW[i]][READ_COLUMN[i]] = partials[i];
    for (int s = 0; s < Z; s++) {
        double width = r[s], error = reading[s] - z[s];
        for (int i = 0; i < HELD; i++) {
            ph[i] = 0.0;
            for (int j = 0; j < HELD; j++)
                ph[i] += cov[i * HELD + j] * row[s][j];
        }
        for (int i = 0; i < HELD; i++) {
            width += row[s][i] * ph[i];
            error -= row[s][i] * change[i];
        }
        for (int i = 0; i < HELD; i++) {
            change[i] += ph[i] * error / width;
            for (int j = 0; j < HELD; j++)
                cov[i * HELD + j] -= ph[i] * ph[j] / width;
        }
    }
    for (int i = 0; i < HELD; i++)
        y[i] += change[i];
    y[0] = fmax(y[0], 0.0);
    y[1] = fmax(y[1], 0.0);
}

// Extended Kalman filter over n samples: y and its covariance cov (HELD x HELD) move on in place. q: variance that a
// sample adds to each state (HELD), r: of the readings' noise (5). ys: n x N. `room`: (2 HELD + M) x HELD.
void bench_follow(const double *k, double *y, double *cov, long n, const double *u, const double *readings,
                  const double *q, const double *r, double *ys, double *room)
{
    double *f = room, *scratch = room + (HELD + M) * HELD;
    memset(room, 0, (2 * HELD + M) * HELD * sizeof *room);
    for (long h = 0; h < n; h++) {
        memset(f, 0, HELD * HELD * sizeof *f);
        for (int i = 0; i < HELD; i++)
            f[i * HELD + i] = 1.0;
        sample_moved(k, y, u[h], HELD, f, scratch);
        for (int i = 0; i < HELD; i++)
            for (int j = 0; j < HELD; j++) {
                double sum = 0.0;
                for (int l = 0; l < HELD; l++)
                    sum += f[i * HELD + l] * cov[l * HELD + j];
                scratch[i * HELD + j] = sum;
            }
        for (int i = 0; i < HELD; i++)
            for (int j = 0; j <= i; j++) {
                double sum = i == j ? q[i] : 0.0;
                for (int l = 0; l < HELD; l++)
                    sum += scratch[i * HELD + l] * f[j * HELD + l];
                cov[i * HELD + j] = cov[j * HELD + i] = sum;
            }
        correct(k, y, cov, readings + Z * h, r);
        memcpy(ys + N * h, y, N * sizeof *y);
    }
}
