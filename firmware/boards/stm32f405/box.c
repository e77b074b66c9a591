/* SPDX-License-Identifier: Apache-2.0 */
/* The box of examples/bare_metal.c on an STM32F405: its functions of the board, its interrupts.
 *
 *   USART1 (PA9, PA10)   the line to the host, 2 Mbaud
 *   USART2 (PA2, PA3)    stands for the converters, 2 Mbaud: a current out starts a conversion, five readings come back
 *   SysTick              1 kHz, begins a sample, which is PendSV: bytes come in and go out meanwhile. On an emulated
 *                        core the end of a conversion begins it
 *   IWDG                 10 ms; SysTick, too, restarts a core whose samples stay away, where there is no IWDG
 *
 * Frames of the converters, counts little-endian, the last byte the sum of those before:
 *
 *   out   5A  n  current (2)                       32768 is 0 A, 32767 more valve_current_max; n is 0 only behind a reset
 *   in    A5  n  f_h f_l p_a p_b x_p (2 each)      from the middle of a reading's range, 1.25 times it over 65535
 */
#include "../../examples/bare_metal.c"

#include "startup.h"

#define BOARD_FRAME 13        /* bytes of a conversion */
#define BOARD_LOST 3          /* samples without a conversion after which the readings are none */
#define BOARD_STUCK 100       /* equal counts of a reading after which its converter is stuck: noise moves a live one */
#define BOARD_WATCHDOG 20     /* ms without a sample after which SysTick restarts the core */
#define BOARD_SENT_MAX 2048u  /* bytes of a ring; a power of two */

typedef struct {
    volatile uint32_t write_at, read_at;
    uint8_t data[BOARD_SENT_MAX];
} board_ring;

static board_ring to_host, to_converters;
static uint8_t conversion[BOARD_FRAME];
static uint32_t conversion_count;
static uint16_t counts[5], before[5];
static uint32_t equal[5];
static volatile uint32_t conversions, unfed;
static volatile bool due;
static uint32_t conversions_read, lost = BOARD_LOST, currents;

/* Survives a reset, not a power-off; an emulator writes here what a random number generator would have given. */
static volatile struct {
    uint32_t seed, restarts;
} kept __attribute__((section(".noinit")));

/* All or nothing. Without DMA: the interrupt is pended by hand once, then comes whenever a byte can be taken. */
static size_t board_put(
    board_ring *ring, board_usart *usart, uint32_t interrupt, const uint8_t *data, size_t count)
{
    uint32_t at = ring->write_at;
    if (count > BOARD_SENT_MAX - (at - ring->read_at)) {
        return 0;
    }
    for (size_t i = 0; i < count; i++) {
        ring->data[at++ % BOARD_SENT_MAX] = data[i];
    }
    ring->write_at = at;
    usart->CR1 = USART_ON | USART_TXE;
    NVIC_ISPR[interrupt / 32] = 1u << interrupt % 32;
    return count;
}

/* An interrupt of a USART: what can go out, or a byte in. An emulated one takes every byte at once, and each look at its
 * state costs an emulator more than the byte: there the ring tells what the interrupt was for. */
static void board_serve(board_ring *ring, board_usart *usart, void (*take)(uint8_t))
{
    bool sends = ring->read_at != ring->write_at;
    while (ring->read_at != ring->write_at && (board_is_emulated || (usart->SR & USART_TXE) != 0)) {
        usart->DR = ring->data[ring->read_at++ % BOARD_SENT_MAX];
    }
    if (sends && ring->read_at == ring->write_at) {
        usart->CR1 = USART_ON;
    }
    if (board_is_emulated ? !sends : (usart->SR & USART_RXNE) != 0) {
        take((uint8_t)usart->DR);
    }
}

static void board_on_usart1(void)
{
    board_serve(&to_host, USART1, board_on_byte);
}

static uint8_t board_sum(const uint8_t *data, size_t count)
{
    uint32_t sum = 0;
    for (size_t i = 0; i < count; i++) {
        sum += data[i];
    }
    return (uint8_t)sum;
}

static void board_on_conversion_byte(uint8_t byte)
{
    if (conversion_count == 0 && byte != 0xA5) {
        return;
    }
    conversion[conversion_count++] = byte;
    if (conversion_count < BOARD_FRAME) {
        return;
    }
    conversion_count = 0;
    if (board_is_emulated) {
        due = true;
        SCB_ICSR = 1u << 28; /* PendSV */
    }
    if (board_sum(conversion, BOARD_FRAME - 1) == conversion[BOARD_FRAME - 1]) {
        for (int i = 0; i < 5; i++) {
            counts[i] = (uint16_t)(conversion[2 + 2 * i] | conversion[3 + 2 * i] << 8);
        }
        conversions = conversions + 1;
    }
}

static void board_on_usart2(void)
{
    board_serve(&to_converters, USART2, board_on_conversion_byte);
}

/* An emulated core has the end of a conversion for its clock: its host may be late, but no sample is. */
static void board_on_systick(void)
{
    if (!board_is_emulated) {
        due = true;
        SCB_ICSR = 1u << 28;
    }
    unfed = due ? unfed + 1 : 0;
    if (unfed > BOARD_WATCHDOG) {
        board_restart();
    }
}

uint32_t board_count_power_ons(void)
{
    uint32_t number;
    RNG_CR = 1u << 2;
    if (board_wait_for(&RNG_SR, 1u, 1u)) {
        number = RNG_DR;
    } else {
        kept.restarts = kept.restarts + 1;
        number = (kept.seed + kept.restarts) * 2654435761u;
    }
    return number == 0 ? 1 : number;
}

void board_read(hydro_real raw[5])
{
    static const int value[5] = {0, 2, 4, 5, 6};
    uint32_t now = conversions;
    lost = now == conversions_read ? lost + 1 : 0;
    conversions_read = now;
    for (int i = 0; i < 5; i++) {
        hydro_real low = HYDRO_BOX_CONFIG.low[value[i]], high = HYDRO_BOX_CONFIG.high[value[i]];
        uint16_t count = counts[i];
        if (lost == 0) {
            equal[i] = count == before[i] ? equal[i] + 1 : 0;
            before[i] = count;
        }
        raw[i] = HYDRO_R(0.5) * (low + high)
                 + HYDRO_R(1.25) * (high - low) * (((hydro_real)count - HYDRO_R(32767.5)) / HYDRO_R(65535));
        if (lost >= BOARD_LOST || (i < 4 && equal[i] >= BOARD_STUCK)) { /* an encoder at rest is still */
            raw[i] = __builtin_nanf("");
        }
    }
}

void board_hold_current(hydro_real ampere)
{
    hydro_real most = HYDRO_BOX_CONFIG.bench.valve_current_max;
    int32_t count = (int32_t)(HYDRO_R(32767) * (ampere / most) + (ampere < 0 ? HYDRO_R(-0.5) : HYDRO_R(0.5))) + 32768;
    uint8_t out[5] = {0x5A, (uint8_t)currents, (uint8_t)count, (uint8_t)(count >> 8), 0};
    currents = currents % 255 + 1;
    out[4] = board_sum(out, 4);
    (void)board_put(&to_converters, USART2, IRQ_USART2, out, sizeof out);
}

size_t board_send(const uint8_t *data, size_t count)
{
    return board_put(&to_host, USART1, IRQ_USART1, data, count);
}

void board_feed_watchdog(void)
{
#ifdef HYDRO_HANG
    static uint32_t armed;
    armed += box.arming.armed ? 1u : 0u;
    while (armed >= 1000) {
    }
#endif
    due = false;
    unfed = 0;
    IWDG_KR = 0xAAAAu;
}

void board_sleep(void)
{
    __asm volatile("wfi");
}

static void board_enable(uint32_t interrupt, uint8_t priority)
{
    NVIC_IPR[interrupt] = priority;
    NVIC_ISER[interrupt / 32] = 1u << interrupt % 32;
}

void board_begin(void)
{
    board_enable(IRQ_USART1, 0x40);
    board_enable(IRQ_USART2, 0x40);
    SCB_PENDSV_PRIORITY = 0x80;
    IWDG_KR = 0x5555u;
    IWDG_PR = 0; /* 32 kHz / 4; the oscillator may be from 17 to 47 kHz: 7 to 19 ms */
    IWDG_RLR = 80;
    IWDG_KR = 0xCCCCu;
    SYST_RVR = BOARD_CLOCK / 1000 - 1;
    SYST_CVR = 0;
    SYST_CSR = 7;
}

typedef void (*board_vector)(void);

__attribute__((section(".vectors"), used)) static const board_vector vectors[16 + IRQ_COUNT] = {
    [0] = (board_vector)_stack_end,
    [1] = board_reset,
    [2 ... 13] = board_unexpected,
    [14] = board_on_millisecond,
    [15] = board_on_systick,
    [16 ... 15 + IRQ_USART1] = board_unexpected,
    [16 + IRQ_USART1] = board_on_usart1,
    [16 + IRQ_USART2] = board_on_usart2,
    [17 + IRQ_USART2 ... 15 + IRQ_COUNT] = board_unexpected,
};
