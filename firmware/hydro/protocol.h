/* SPDX-License-Identifier: Apache-2.0 */
/* Frames: bytes and values, COBS, CRC-32. The byte tables stand in docs/manual/reference/protocol.md. */
#ifndef HYDRO_PROTOCOL_H
#define HYDRO_PROTOCOL_H

#include "config.h"

#define HYDRO_VERSION 4u /* the only one; HELLO has 0, so that any two ends can read it */
#define HYDRO_ENCODED_MAX 160u /* bytes between two delimiters; more is noise */
#define HYDRO_FRAME_MAX 141u   /* bytes of the longest frame that a box sends, delimiters included */
#define HYDRO_HEADER 14u
#define HYDRO_STATE_REALS 14

enum { HYDRO_HELLO = 1, HYDRO_STATE = 2, HYDRO_COMMAND = 3, HYDRO_DETAILS = 4, HYDRO_LAW = 5 };
enum { HYDRO_HOLD = 0, HYDRO_SINE = 1, HYDRO_MULTISINE = 2, HYDRO_SMOOTH_STEP = 3 };

enum {
    HYDRO_ARMED = 1,
    HYDRO_SATURATED = 2,
    HYDRO_WATCHDOG = 4,
    HYDRO_TRIPPED = 8,
    HYDRO_SENSOR_FAULT = 16,
    HYDRO_FORCE_LIMIT = 32,
    HYDRO_FILTER_STALE = 64
};

/* A reference signal; `start` is the box time [s] at which its own time is 0. */
typedef struct {
    uint32_t waveform;
    hydro_real amplitude, offset; /* N */
    hydro_time frequency, phase;  /* Hz, rad */
    hydro_time start;             /* s */
} hydro_signal;

/* One COMMAND. Numbers that are not finite have their bit in `broken`, and are 0 here. */
typedef struct {
    uint32_t sequence, corrects;
    bool arm, filter_fresh;
    uint32_t broken;                          /* bit 0 delta_kp, 1 delta_ki, 2 delta_u, 3 the reference, 4 on shaping */
    hydro_real delta_kp, delta_ki, delta_u;   /* 1/s, 1/s^2, A */
    hydro_signal reference;
    uint32_t law;
    hydro_real shaping[HYDRO_SHAPING];
} hydro_command;

#define HYDRO_NEUTRAL {1, 0, 0, 0, 0, 1, 1} /* shaping of the paper's law */

/* The force law as it acted in a sample: f_c [N], f_c' [N/s], and its shaping. */
typedef struct {
    uint32_t law;
    hydro_real reference, reference_rate, shaping[HYDRO_SHAPING];
} hydro_law_state;

/* One sample, laid out as hydro_core.signals.STATE_DTYPE where hydro_real is double. */
typedef struct {
    hydro_time time;
    uint32_t sequence;
    hydro_real values[HYDRO_STATE_REALS]; /* the measurement; current, nominal current; f_r, f_r'; K_p, K_i */
    uint32_t flags;
} hydro_sample;

enum { HYDRO_CURRENT = 8, HYDRO_NOMINAL, HYDRO_REFERENCE, HYDRO_REFERENCE_RATE, HYDRO_KP, HYDRO_KI };

static inline uint32_t hydro_crc(const uint8_t *data, size_t count)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < count; i++) {
        crc = table[(crc ^ data[i]) & 15u] ^ (crc >> 4);
        crc = table[(crc ^ (uint32_t)(data[i] >> 4)) & 15u] ^ (crc >> 4);
    }
    return crc ^ 0xFFFFFFFFu;
}

static inline uint32_t hydro_read32(const uint8_t *data)
{
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
}

static inline void hydro_write32(uint8_t *data, uint32_t value)
{
    for (int i = 0; i < 4; i++) {
        data[i] = (uint8_t)(value >> 8 * i & 0xFFu);
    }
}

static inline void hydro_write64(uint8_t *data, uint64_t value)
{
    hydro_write32(data, (uint32_t)(value & 0xFFFFFFFFu));
    hydro_write32(data + 4, (uint32_t)(value >> 32));
}

/* COBS in place: `data`, fewer than 254 bytes without delimiters, becomes what it stands for; how many bytes, or 0. */
static inline size_t hydro_unstuff(uint8_t *data, size_t count)
{
    size_t read = 0, written = 0;
    while (read < count) {
        uint8_t code = data[read++];
        if (code - 1u > count - read) {
            return 0;
        }
        for (uint8_t i = 1; i < code; i++) {
            data[written++] = data[read++];
        }
        if (read < count) {
            data[written++] = 0;
        }
    }
    return written;
}

/* A whole frame of `count` bytes of body, fewer than 250, into `out` with its delimiters; how many bytes it has. */
static inline size_t hydro_wrap(uint8_t *body, size_t count, uint8_t *out)
{
    size_t written = 2, code = 1;
    hydro_write32(body + count, hydro_crc(body, count));
    out[0] = 0;
    for (size_t i = 0; i < count + 4; i++) {
        if (body[i] != 0) {
            out[written++] = body[i];
        } else {
            out[code] = (uint8_t)(written - code);
            code = written++;
        }
    }
    out[code] = (uint8_t)(written - code);
    out[written++] = 0;
    return written;
}

static inline void hydro_head(uint8_t *body, uint8_t version, uint8_t kind, uint32_t sequence, uint64_t time_us)
{
    body[0] = version;
    body[1] = kind;
    hydro_write32(body + 2, sequence);
    hydro_write64(body + 6, time_us);
}

/* Numbers as float32; where they end. */
static inline uint8_t *hydro_write_reals(uint8_t *at, const hydro_real *numbers, int count)
{
    for (int i = 0; i < count; i++, at += 4) {
        hydro_write32(at, hydro_bits(numbers[i]));
    }
    return at;
}

static inline size_t hydro_encode_state(
    const hydro_sample *sample, uint32_t last_command, const uint32_t refused[2], const hydro_law_state *acting,
    uint8_t *out)
{
    uint8_t body[HYDRO_HEADER + 112 + 4];
    uint8_t *at = hydro_write_reals(body + HYDRO_HEADER, sample->values, HYDRO_STATE_REALS);
    hydro_head(body, HYDRO_VERSION, HYDRO_STATE, sample->sequence, (uint64_t)(sample->time * 1e6 + 0.5));
    hydro_write32(at, sample->flags);
    hydro_write32(at + 4, last_command);
    hydro_write32(at + 8, refused[0]);
    hydro_write32(at + 12, refused[1]);
    hydro_write32(at + 16, acting->law);
    at = hydro_write_reals(at + 20, &acting->reference, 1);
    at = hydro_write_reals(at, &acting->reference_rate, 1);
    (void)hydro_write_reals(at, acting->shaping, HYDRO_SHAPING);
    return hydro_wrap(body, HYDRO_HEADER + 112, out);
}

static inline size_t hydro_encode_hello(uint32_t sequence, uint64_t time_us, const hydro_config *config, uint8_t *out)
{
    uint8_t body[HYDRO_HEADER + 72 + 4];
    uint8_t *at = body + HYDRO_HEADER;
    const hydro_law *law = &config->laws[HYDRO_PAPER];
    const hydro_real numbers[9] = {
        config->bench.valve_current_max, law->base_kp, law->base_ki, law->delta_kp_min, law->delta_kp_max,
        law->delta_ki_min, law->delta_ki_max, config->delta_u_max, HYDRO_R(HYDRO_PERIOD)};
    hydro_head(body, 0, HYDRO_HELLO, sequence, time_us);
    at[0] = at[1] = HYDRO_VERSION;
    at[2] = 1;
    at[3] = (uint8_t)config->integral_form;
    hydro_copy(at + 4, config->name, sizeof config->name);
    (void)hydro_write_reals(at + 36, numbers, 9);
    return hydro_wrap(body, HYDRO_HEADER + 72, out);
}

static inline size_t hydro_encode_details(
    uint32_t sequence, uint64_t time_us, uint32_t epoch, const hydro_config *config, uint8_t *out)
{
    uint8_t body[HYDRO_HEADER + 60 + 4];
    uint8_t *at = body + HYDRO_HEADER;
    const hydro_real numbers[10] = {
        config->load_force_limit, config->force_range, config->low[4], config->high[4], config->low[6],
        config->high[6], HYDRO_R(config->hold_timeout), HYDRO_R(config->trip_timeout), config->force_rate_age,
        config->velocity_age};
    hydro_head(body, HYDRO_VERSION, HYDRO_DETAILS, sequence, time_us);
    hydro_write32(at, epoch);
    hydro_copy(at + 4, config->digest, sizeof config->digest);
    at[16] = config->feedback == 2u ? 1 : 2;
    at[17] = 1u << HYDRO_PAPER | 1u << HYDRO_COMPENSATED;
    at[18] = at[19] = 0;
    (void)hydro_write_reals(at + 20, numbers, 10);
    return hydro_wrap(body, HYDRO_HEADER + 60, out);
}

/* The compensated law. */
static inline size_t hydro_encode_law(uint32_t sequence, uint64_t time_us, const hydro_config *config, uint8_t *out)
{
    uint8_t body[HYDRO_HEADER + 120 + 4];
    uint8_t *at = body + HYDRO_HEADER;
    const hydro_law *law = &config->laws[HYDRO_COMPENSATED];
    const hydro_real numbers[14] = {
        law->base_kp, law->base_ki, law->delta_kp_min, law->delta_kp_max, law->delta_ki_min, law->delta_ki_max,
        law->safe[5], law->low[5], law->high[5], law->safe[6], law->low[6], law->high[6], law->rate[5],
        law->reference_max};
    hydro_head(body, HYDRO_VERSION, HYDRO_LAW, sequence, time_us);
    hydro_write32(at, HYDRO_COMPENSATED);
    at = hydro_write_reals(at + 4, numbers, 14);
    at = hydro_write_reals(at, law->low, HYDRO_COEFFICIENTS);
    at = hydro_write_reals(at, law->high, HYDRO_COEFFICIENTS);
    (void)hydro_write_reals(at, law->rate, HYDRO_COEFFICIENTS);
    return hydro_wrap(body, HYDRO_HEADER + 120, out);
}

/* A finite float32 of the line; one that is not finite gives 0 and sets `bit` of `broken`. */
static inline float hydro_take_real(const uint8_t *data, uint32_t bit, uint32_t *broken)
{
    uint32_t bits = hydro_read32(data);
    float value;
    if (!hydro_finite_bits(bits)) {
        *broken |= bit;
        return 0.0f;
    }
    hydro_copy(&value, &bits, sizeof value);
    return value;
}

/* Payload of a COMMAND, 72 bytes; false if its waveform or its law is none. */
static inline bool hydro_decode_command(uint32_t sequence, const uint8_t *data, hydro_command *command)
{
    uint32_t bits = hydro_read32(data);
    command->sequence = sequence;
    command->arm = (bits & 1u) != 0;
    command->filter_fresh = (bits & 2u) != 0;
    command->corrects = hydro_read32(data + 4);
    command->broken = 0;
    command->delta_kp = hydro_take_real(data + 8, 1u, &command->broken);
    command->delta_ki = hydro_take_real(data + 12, 2u, &command->broken);
    command->delta_u = hydro_take_real(data + 16, 4u, &command->broken);
    command->reference.waveform = hydro_read32(data + 20);
    command->reference.amplitude = hydro_take_real(data + 24, 8u, &command->broken);
    command->reference.offset = hydro_take_real(data + 28, 8u, &command->broken);
    command->reference.frequency = hydro_take_real(data + 32, 8u, &command->broken);
    command->reference.phase = hydro_take_real(data + 36, 8u, &command->broken);
    command->reference.start = 0.0;
    command->law = hydro_read32(data + 40);
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        command->shaping[i] = hydro_take_real(data + 44 + 4 * i, 16u << i, &command->broken);
    }
    return command->reference.waveform <= HYDRO_SMOOTH_STEP && command->law <= HYDRO_COMPENSATED;
}

#endif
