/* SPDX-License-Identifier: Apache-2.0 */
/* Numbers of the box: their width, what is finite, and the three functions of the target's mathematics library.
 *
 * hydro_real is double, or float with HYDRO_SINGLE. hydro_time, seconds of the box's clock, is double in both: after
 * a day a float could not count milliseconds. No function here raises a floating-point exception, whatever it is given:
 * a number from outside is looked at by its bits before it is compared.
 */
#ifndef HYDRO_NUMBER_H
#define HYDRO_NUMBER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef HYDRO_SINGLE
typedef float hydro_real;
#else
typedef double hydro_real;
#endif
typedef double hydro_time;

#define HYDRO_R(x) ((hydro_real)(x))
#define HYDRO_PI 3.141592653589793

/* sin, cos and sqrt of the target; define all three where the compiler's own are not meant. */
#ifndef HYDRO_SIN
#ifdef HYDRO_SINGLE
#define HYDRO_SIN(x) __builtin_sinf(x)
#define HYDRO_COS(x) __builtin_cosf(x)
#define HYDRO_SQRT(x) __builtin_sqrtf(x)
#else
#define HYDRO_SIN(x) __builtin_sin(x)
#define HYDRO_COS(x) __builtin_cos(x)
#define HYDRO_SQRT(x) __builtin_sqrt(x)
#endif
#endif

static inline void hydro_copy(void *target, const void *source, size_t count)
{
    uint8_t *to = (uint8_t *)target;
    const uint8_t *from = (const uint8_t *)source;
    for (size_t i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

/* By the bits: a comparison with NaN would raise FE_INVALID. */
#ifdef HYDRO_SINGLE
typedef uint32_t hydro_pattern;
#define HYDRO_EXPONENT 0x7F800000u
#define HYDRO_SIGN 0x80000000u
#else
typedef uint64_t hydro_pattern;
#define HYDRO_EXPONENT 0x7FF0000000000000u
#define HYDRO_SIGN 0x8000000000000000u
#endif

static inline hydro_pattern hydro_pattern_of(hydro_real value)
{
    hydro_pattern bits;
    hydro_copy(&bits, &value, sizeof bits);
    return bits;
}

static inline bool hydro_finite(hydro_real value)
{
    return (hydro_pattern_of(value) & HYDRO_EXPONENT) != HYDRO_EXPONENT;
}

static inline bool hydro_nan(hydro_real value)
{
    return (hydro_pattern_of(value) & ~HYDRO_SIGN) > HYDRO_EXPONENT;
}

static inline bool hydro_finite_bits(uint32_t bits)
{
    return (bits & 0x7F800000u) != 0x7F800000u;
}

static inline hydro_real hydro_abs(hydro_real x)
{
    return x < HYDRO_R(0) ? -x : x;
}

/* Whether a number is finite, and its magnitude no more than `most`. */
static inline bool hydro_within(hydro_real value, hydro_real most)
{
    return hydro_finite(value) && hydro_abs(value) <= most;
}

static inline hydro_real hydro_max(hydro_real x, hydro_real y)
{
    return x < y ? y : x;
}

static inline hydro_real hydro_clamp(hydro_real x, hydro_real low, hydro_real high)
{
    return x < low ? low : (x > high ? high : x);
}

/* x - floor(x) of a finite x; exact but for a negative x near 0, which gives 1. */
static inline hydro_time hydro_fraction(hydro_time x)
{
    if (x >= 4503599627370496.0 || x <= -4503599627370496.0) {
        return 0.0; /* 2^52: whole numbers only from here on */
    }
    x -= (hydro_time)(int64_t)x;
    return x < 0.0 ? x + 1.0 : x;
}

/* An angle [rad] for sin and cos: in single precision reduced to one turn first. */
static inline hydro_real hydro_turned(hydro_time angle)
{
#ifdef HYDRO_SINGLE
    return (hydro_real)(2.0 * HYDRO_PI * hydro_fraction(angle / (2.0 * HYDRO_PI)));
#else
    return angle;
#endif
}

/* float32 of a number: infinite beyond its range, without an exception. */
static inline uint32_t hydro_bits(hydro_real value)
{
    uint32_t bits;
    float single;
#ifdef HYDRO_SINGLE
    single = value;
#else
    uint32_t sign = (uint32_t)(hydro_pattern_of(value) >> 63) << 31;
    if (hydro_nan(value)) {
        return sign | 0x7FC00000u;
    }
    if (value > 3.4028234e38 || value < -3.4028234e38) {
        return sign | 0x7F800000u;
    }
    single = (float)value;
#endif
    hydro_copy(&bits, &single, sizeof bits);
    return bits;
}

#endif
