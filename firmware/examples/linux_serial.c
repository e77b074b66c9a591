/* SPDX-License-Identifier: Apache-2.0 */
/* A box on Linux with a real serial port: linux_serial PORT [SECONDS].
 *
 * The bench is a stub that stands still: f_l 12.5 N, mid-stroke. Put your converters into read_sensors and
 * hold_current.
 * 2 Mbaud, 8N1, raw. Real time: run it by `chrt -f 80`, on a kernel with PREEMPT_RT where valves hang on it.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/random.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../hydro/box.h"

#include "box_config.h"

static void read_sensors(hydro_real raw[5])
{
    raw[0] = HYDRO_R(12.5);
    raw[1] = HYDRO_R(12.5);
    raw[2] = HYDRO_R(6.1e6);
    raw[3] = HYDRO_R(9.9e6);
    raw[4] = HYDRO_R(0.04);
}

static void hold_current(hydro_real ampere)
{
    (void)ampere;
}

static volatile sig_atomic_t ended;

static void end(int signal_number)
{
    (void)signal_number;
    ended = 1;
}

/* Ctrl-C, a stop of the service and a closed terminal end the loop, and the current goes to 0 behind it. */
static void end_on_signals(void)
{
    static const int signals[3] = {SIGINT, SIGTERM, SIGHUP};
    struct sigaction action = {.sa_handler = end};
    for (int i = 0; i < 3; i++) {
        (void)sigaction(signals[i], &action, NULL);
    }
}

/* A number that two starts do not share, and that is not 0: a clock in seconds repeats where a service restarts. */
static uint32_t drawn_epoch(void)
{
    uint32_t epoch = 0;
    while (epoch == 0) {
        if (getrandom(&epoch, sizeof epoch, 0) != (ssize_t)sizeof epoch && errno != EINTR) {
            perror("getrandom");
            exit(2);
        }
    }
    return epoch;
}

static int open_port(const char *path)
{
    struct termios settings;
    int port = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (port < 0 || tcgetattr(port, &settings) != 0) {
        perror(path);
        exit(2);
    }
    cfmakeraw(&settings);
    (void)cfsetspeed(&settings, B2000000);
    if (tcsetattr(port, TCSANOW, &settings) != 0) {
        perror(path);
        exit(2);
    }
    return port;
}

/* A burst begun is finished before the next, so that no frame is cut; one that finds the line full is dropped whole. */
typedef struct {
    uint8_t data[HYDRO_BURST_MAX];
    size_t count, sent;
} burst;

static void pour(int port, burst *line)
{
    ssize_t count;
    while (line->sent < line->count && (count = write(port, line->data + line->sent, line->count - line->sent)) > 0) {
        line->sent += (size_t)count;
    }
}

static void send_up(int port, burst *line, hydro_box *box)
{
    uint8_t dropped[HYDRO_BURST_MAX];
    pour(port, line);
    if (line->sent < line->count) { /* nobody reads */
        (void)hydro_box_frames(box, dropped);
        return;
    }
    line->count = hydro_box_frames(box, line->data);
    line->sent = 0;
    pour(port, line);
}

int main(int argc, char **argv)
{
    static hydro_box box;
    static hydro_rates rates;
    static burst line;
    hydro_real raw[5], measurement[HYDRO_MEASURED];
    uint8_t in[4096];
    struct timespec due;
    unsigned long samples, tick;
    int port;
    if (argc < 2) {
        fprintf(stderr, "usage: linux_serial PORT [SECONDS]\n");
        return 2;
    }
    samples = argc > 2 ? 1000 * strtoul(argv[2], NULL, 10) : 0; /* 0: until it is ended */
    port = open_port(argv[1]);
    end_on_signals();
    hydro_box_power_on(&box, &HYDRO_BOX_CONFIG, drawn_epoch());
    hydro_rates_reset(&rates, &HYDRO_BOX_CONFIG);
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (tick = 0; !ended && (samples == 0 || tick < samples); tick++) {
        ssize_t count = read(port, in, sizeof in);
        if (count > 0) {
            hydro_box_bytes(&box, in, (size_t)count);
        }
        read_sensors(raw);
        hydro_differentiate(&rates, raw, measurement);
        hold_current(hydro_box_tick(&box, measurement, (hydro_time)tick * HYDRO_PERIOD));
        send_up(port, &line, &box);
        due.tv_nsec += 1000000;
        due.tv_sec += due.tv_nsec / 1000000000;
        due.tv_nsec %= 1000000000;
        (void)clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    }
    hold_current(HYDRO_R(0));
    printf("%lu samples, %u commands taken, %u old or repeated, %u greetings\n", tick, (unsigned)box.taken,
           (unsigned)box.stale, (unsigned)box.greetings);
    return 0;
}
