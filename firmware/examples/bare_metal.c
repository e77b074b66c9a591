/* SPDX-License-Identifier: Apache-2.0 */
/* A box on a bare microcontroller: what its main loop and its interrupts do. Fill in the functions of the board
 * (boards/stm32f405 has them for one).
 *
 * The UART's interrupt only stores bytes; the timer's, each millisecond, runs the box. Compile with HYDRO_SINGLE where
 * the processor has single precision in hardware. The command that makes box_config.h is in your_own_box.md.
 */
#include "../hydro/box.h"

#include "box_config.h"

/* Of the board. */
void board_begin(void);                               /* clocks, timer at 1 kHz, UART at 2 Mbaud, watchdog of 10 ms */
uint32_t board_count_power_ons(void);                 /* kept over power-off, or a number drawn at random; not 0 */
void board_read(hydro_real raw[5]);                   /* f_h N, f_l N, p_a Pa, p_b Pa, x_p m */
void board_hold_current(hydro_real ampere);           /* until the next call */
size_t board_send(const uint8_t *data, size_t count); /* by DMA; takes all or nothing */
void board_feed_watchdog(void);
void board_sleep(void);                               /* until an interrupt */

static hydro_box box;
static hydro_rates rates;
static hydro_real measurement[HYDRO_MEASURED];
static volatile uint8_t received[1024];
static volatile uint32_t write_at;
static uint32_t read_at, tick;

/* Interrupt of the UART. A ring that runs over loses frames, which the stream decoder survives. */
void board_on_byte(uint8_t byte)
{
    received[write_at % sizeof received] = byte;
    write_at = write_at + 1;
}

/* Interrupt of the timer, each millisecond. */
void board_on_millisecond(void)
{
    uint8_t out[HYDRO_BURST_MAX];
    hydro_real raw[5];
    for (uint32_t i = 0; i < 256 && read_at != write_at; i++) { /* bounded: 2 Mbaud bring 200 bytes a millisecond */
        uint8_t byte = received[read_at++ % sizeof received];
        hydro_box_bytes(&box, &byte, 1);
    }
    board_read(raw);
    hydro_differentiate(&rates, raw, measurement);
    board_hold_current(hydro_box_tick(&box, measurement, (hydro_time)tick++ * HYDRO_PERIOD));
    (void)board_send(out, hydro_box_frames(&box, out));
    board_feed_watchdog(); /* only from here: a box that misses a sample is reset, and comes up disarmed */
}

int main(void)
{
    board_hold_current(HYDRO_R(0));
    hydro_box_power_on(&box, &HYDRO_BOX_CONFIG, board_count_power_ons());
    hydro_rates_reset(&rates, &HYDRO_BOX_CONFIG);
    board_begin();
    for (;;) {
        board_sleep();
    }
}
