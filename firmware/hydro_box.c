/* SPDX-License-Identifier: Apache-2.0 */
/* The box as a shared library, for simulation, emulator, training and tests: hydro_sim.box.firmware. The caller gives
 * the memory, and the configuration with each call that reads it: neither stays where it is. Commands, samples and
 * numbers of a call are double in both precisions, but a command's record is hydro_command. */
#include "hydro/box.h"

/* One sample, laid out as hydro_core.signals.STATE_DTYPE. */
typedef struct {
    double time;
    uint32_t sequence;
    double values[HYDRO_STATE_REALS];
    uint32_t flags;
} hydro_c_sample;

void hydro_c_sizes(size_t sizes[4])
{
    sizes[0] = sizeof(hydro_box);
    sizes[1] = sizeof(hydro_config);
    sizes[2] = sizeof(hydro_command);
    sizes[3] = sizeof(hydro_signal);
}

void hydro_c_power_on(hydro_box *box, const hydro_config *config, uint32_t epoch)
{
    hydro_box_power_on(box, config, epoch);
}

/* A finite number; one that is not gives 0 and sets `bit` of `broken`. */
static double checked(double value, uint32_t bit, uint32_t *broken)
{
    if (__builtin_isfinite(value)) {
        return value;
    }
    *broken |= bit;
    return 0.0;
}

/* A command past the line, at box time [s]; as on the line one for a law or with a waveform that is none is dropped. */
void hydro_c_receive(hydro_box *box, const hydro_config *config, const hydro_command *given, double time)
{
    hydro_command command = *given;
    hydro_signal *reference = &command.reference;
    uint32_t *broken = &command.broken;
    if (reference->waveform > HYDRO_SMOOTH_STEP || command.law > HYDRO_COMPENSATED) {
        return;
    }
    *broken = 0;
    command.delta_kp = (hydro_real)checked(command.delta_kp, 1u, broken);
    command.delta_ki = (hydro_real)checked(command.delta_ki, 2u, broken);
    command.delta_u = (hydro_real)checked(command.delta_u, 4u, broken);
    reference->amplitude = (hydro_real)checked(reference->amplitude, 8u, broken);
    reference->offset = (hydro_real)checked(reference->offset, 8u, broken);
    reference->frequency = checked(reference->frequency, 8u, broken);
    reference->phase = checked(reference->phase, 8u, broken);
    for (int i = 0; i < HYDRO_SHAPING; i++) {
        command.shaping[i] = (hydro_real)checked(command.shaping[i], 16u << i, broken);
    }
    box->config = config;
    hydro_box_take(box, &command, time);
}

void hydro_c_tick(
    hydro_box *box, const hydro_config *config, const double *measurement, double time, hydro_c_sample *sample)
{
    hydro_real values[HYDRO_MEASURED];
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        values[i] = (hydro_real)measurement[i];
    }
    box->config = config;
    (void)hydro_box_tick(box, values, time);
    sample->time = box->sample.time;
    sample->sequence = box->sample.sequence;
    for (int i = 0; i < HYDRO_STATE_REALS; i++) {
        sample->values[i] = box->sample.values[i];
    }
    sample->flags = box->sample.flags;
}

void hydro_c_bytes(hydro_box *box, const uint8_t *data, size_t count)
{
    hydro_box_bytes(box, data, count);
}

size_t hydro_c_frames(hydro_box *box, const hydro_config *config, uint8_t *out)
{
    box->config = config;
    return hydro_box_frames(box, out);
}

double hydro_c_nominal_current(
    const hydro_config *config, const double *measurement, double error, double action, double reference_rate,
    double proportional_gain, double velocity_compensation, double valve_gain_scale)
{
    const hydro_real scales[2] = {(hydro_real)velocity_compensation, (hydro_real)valve_gain_scale};
    hydro_real values[HYDRO_MEASURED];
    for (int i = 0; i < HYDRO_MEASURED; i++) {
        values[i] = (hydro_real)measurement[i];
    }
    return hydro_nominal_current(
        config, values, (hydro_real)error, (hydro_real)action, (hydro_real)reference_rate,
        (hydro_real)proportional_gain, scales);
}

/* Value [N] and rate [N/s] of a reference at `count` times [s]. */
void hydro_c_play(const hydro_signal *signal, const double *times, size_t count, double *values, double *rates)
{
    for (size_t i = 0; i < count; i++) {
        hydro_wave wave = hydro_play(signal, times[i]);
        values[i] = wave.value;
        rates[i] = wave.rate;
    }
}
