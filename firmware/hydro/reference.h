/* SPDX-License-Identifier: Apache-2.0 */
/* The force to track: waveforms with exact derivatives, and a cross-fade of 0.3 s, C^3, between them. */
#ifndef HYDRO_REFERENCE_H
#define HYDRO_REFERENCE_H

#include "protocol.h"

#define HYDRO_FADE 0.3   /* s */
#define HYDRO_EDGE 0.125 /* of a period, length of a smooth step's edge */

/* `coming` fades in over `leaving` from `fade_start` on; `wanted` is what was last asked for. */
typedef struct {
    hydro_signal leaving, coming, wanted;
    hydro_time fade_start;
} hydro_reference;

/* f_r [N], f_r' [N/s], f_r'' [N/s^2], f_r''' [N/s^3], f_r'''' [N/s^4]; at a kink those of the side that follows. */
typedef struct {
    hydro_real value, rate, second, third, fourth;
} hydro_wave;

static inline hydro_wave hydro_multisine(hydro_time angle, hydro_time phase)
{
    static const hydro_time ratios[4] = {1.0, 1.7320508075688772, 2.6457513110645907, 3.605551275463989};
    static const hydro_time weights[4] = {
        0.44789526038332517, 0.2585924491510704, 0.1692884960541141, 0.1242237944114903};
    hydro_wave shape = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)};
    for (int i = 0; i < 4; i++) {
        hydro_real inner = hydro_turned(ratios[i] * angle + (hydro_time)(i + 1) * phase);
        hydro_real sine = (hydro_real)weights[i] * HYDRO_SIN(inner);
        hydro_real cosine = (hydro_real)(weights[i] * ratios[i]) * HYDRO_COS(inner);
        hydro_real square = (hydro_real)(ratios[i] * ratios[i]);
        shape.value += sine;
        shape.rate += cosine;
        shape.second -= square * sine;
        shape.third -= square * cosine;
        shape.fourth += square * square * sine;
    }
    return shape;
}

static inline hydro_wave hydro_smooth_step(hydro_time angle)
{
    hydro_time turn = hydro_fraction(angle / (2.0 * HYDRO_PI));
    hydro_real side = turn < 0.5 ? HYDRO_R(1) : HYDRO_R(-1);
    hydro_wave shape = {side, HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)};
    hydro_real edge, steep = HYDRO_R(1.0 / (2.0 * HYDRO_EDGE));
    while (turn >= 0.5) {
        turn -= 0.5;
    }
    if (turn / HYDRO_EDGE < 1.0) {
        edge = (hydro_real)(HYDRO_PI * (turn / HYDRO_EDGE));
        shape.value = -side * HYDRO_COS(edge);
        shape.rate = side * HYDRO_SIN(edge) * steep;
        shape.second = -shape.value * steep * steep;
        shape.third = -shape.rate * steep * steep;
        shape.fourth = -shape.second * steep * steep;
    }
    return shape;
}

/* One signal at box time [s]. */
static inline hydro_wave hydro_play(const hydro_signal *signal, hydro_time time)
{
    hydro_time omega = 2.0 * HYDRO_PI * signal->frequency;
    hydro_time angle = omega * (time - signal->start);
    hydro_real rate = signal->amplitude * (hydro_real)omega;
    hydro_wave shape = {HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0), HYDRO_R(0)}, result;
    if (signal->waveform == HYDRO_SINE) {
        hydro_real turned = hydro_turned(angle + signal->phase);
        shape.value = HYDRO_SIN(turned);
        shape.rate = HYDRO_COS(turned);
        shape.second = -shape.value;
        shape.third = -shape.rate;
        shape.fourth = shape.value;
    } else if (signal->waveform == HYDRO_MULTISINE) {
        shape = hydro_multisine(angle, signal->phase);
    } else if (signal->waveform == HYDRO_SMOOTH_STEP) {
        shape = hydro_smooth_step(angle + signal->phase);
    }
    result.value = signal->offset + signal->amplitude * shape.value;
    result.rate = rate * shape.rate;
    result.second = rate * (hydro_real)omega * shape.second;
    result.third = rate * (hydro_real)omega * (hydro_real)omega * shape.third;
    result.fourth = rate * (hydro_real)omega * (hydro_real)omega * (hydro_real)omega * shape.fourth;
    return result;
}

static inline void hydro_take_up(hydro_reference *reference, hydro_time time)
{
    reference->coming = reference->wanted;
    reference->coming.start = time;
    reference->fade_start = time;
}

/* Start the wanted signal from a held force [N]: value and rate begin at (force, 0). */
static inline void hydro_begin(hydro_reference *reference, hydro_real force, hydro_time time)
{
    reference->leaving.waveform = HYDRO_HOLD;
    reference->leaving.amplitude = HYDRO_R(0);
    reference->leaving.offset = force;
    hydro_take_up(reference, time);
}

static inline void hydro_reference_reset(hydro_reference *reference)
{
    const hydro_signal still = {HYDRO_HOLD, HYDRO_R(0), HYDRO_R(0), 1.0, 0.0, 0.0};
    reference->leaving = reference->wanted = still;
    hydro_begin(reference, HYDRO_R(0), 0.0);
}

static inline bool hydro_same(const hydro_signal *one, const hydro_signal *other)
{
    return one->waveform == other->waveform && one->amplitude == other->amplitude && one->offset == other->offset
           && one->frequency == other->frequency && one->phase == other->phase;
}

/* f_r and its derivatives at box time [s]; a fade that has ended gives way to what is wanted by now. */
static inline hydro_wave hydro_advance(hydro_reference *reference, hydro_time time)
{
    hydro_wave wave, old;
    hydro_time part;
    hydro_real share, left, product, blend, blend_1, blend_2, blend_3, blend_4, gap, gap_rate, gap_second;
    if (time - reference->fade_start >= HYDRO_FADE && !hydro_same(&reference->wanted, &reference->coming)) {
        reference->leaving = reference->coming;
        hydro_take_up(reference, time);
    }
    wave = hydro_play(&reference->coming, time);
    part = (time - reference->fade_start) / HYDRO_FADE;
    if (part >= 1.0) {
        return wave;
    }
    share = (hydro_real)part;
    old = hydro_play(&reference->leaving, time);
    left = HYDRO_R(1) - share;
    product = share * left;
    blend = HYDRO_R(1) /* as share^4 (35 - 84 share + ...), and as good in single precision at its end */
            - left * left * left * left
                  * (HYDRO_R(1) + share * (HYDRO_R(4) + share * (HYDRO_R(10) + HYDRO_R(20) * share)));
    blend_1 = HYDRO_R(140) * product * product * product / HYDRO_R(HYDRO_FADE);
    blend_2 = HYDRO_R(420) * product * product * (left - share) / HYDRO_R(HYDRO_FADE * HYDRO_FADE);
    blend_3 = HYDRO_R(840) * product * (HYDRO_R(1) - HYDRO_R(5) * product)
              / HYDRO_R(HYDRO_FADE * HYDRO_FADE * HYDRO_FADE);
    blend_4 = HYDRO_R(840) * (left - share) * (HYDRO_R(1) - HYDRO_R(10) * product)
              / HYDRO_R(HYDRO_FADE * HYDRO_FADE * HYDRO_FADE * HYDRO_FADE);
    gap = wave.value - old.value;
    gap_rate = wave.rate - old.rate;
    gap_second = wave.second - old.second;
    wave.fourth = (HYDRO_R(1) - blend) * old.fourth + blend * wave.fourth
                  + (HYDRO_R(4) * blend_1 * (wave.third - old.third) + HYDRO_R(6) * blend_2 * gap_second
                     + HYDRO_R(4) * blend_3 * gap_rate + blend_4 * gap);
    wave.third = (HYDRO_R(1) - blend) * old.third + blend * wave.third
                 + (HYDRO_R(3) * blend_1 * gap_second + HYDRO_R(3) * blend_2 * gap_rate + blend_3 * gap);
    wave.second =
        (HYDRO_R(1) - blend) * old.second + blend * wave.second + HYDRO_R(2) * blend_1 * gap_rate + blend_2 * gap;
    wave.rate = (HYDRO_R(1) - blend) * old.rate + blend * wave.rate + blend_1 * gap;
    wave.value = (HYDRO_R(1) - blend) * old.value + blend * wave.value;
    return wave;
}

#endif
