/* SPDX-License-Identifier: Apache-2.0 */
/* From reset to main: stack painted, floating-point unit on, data and zeros in place, 168 MHz. The vectors are named by
 * the program that includes this. */
#ifndef HYDRO_STARTUP_H
#define HYDRO_STARTUP_H

#include <stdbool.h>

#include "registers.h"

#define BOARD_CLOCK 168000000u /* Hz */
#define BOARD_PAINT 0x57AC57ACu /* of the stack that was never used */
#define BOARD_PATIENCE 20000u /* turns of a loop that waits for hardware: some ms */

extern uint32_t _data[], _data_end[], _data_load[], _bss[], _bss_end[], _stack_begin[], _stack_end[];

static bool board_is_emulated;

int main(void);

static inline void board_restart(void)
{
    SCB_AIRCR = 0x05FA0004u; /* SYSRESETREQ */
    for (;;) {
    }
}

/* An interrupt that nobody asked for, a fault of the core: it comes up disarmed. */
static void board_unexpected(void)
{
    board_restart();
}

/* Whether a bit comes up in time. */
static inline int board_wait_for(volatile uint32_t *where, uint32_t bits, uint32_t value)
{
    for (uint32_t i = 0; i < BOARD_PATIENCE; i++) {
        if ((*where & bits) == value) {
            return 1;
        }
    }
    return 0;
}

/* 168 MHz from a crystal of 8 MHz; APB1 42 MHz, APB2 84 MHz, 48 MHz for the random numbers. Without a clock tree, which
 * shows by the internal oscillator that is off, this is an emulator, whose core runs at 168 MHz from the beginning. */
static inline void board_start_clocks(void)
{
    board_is_emulated = (RCC_CR & 3u) == 0;
    if (board_is_emulated) {
        return;
    }
    RCC_CR |= 1u << 16; /* HSEON */
    RCC_PLLCFGR = 8u | 336u << 6 | 1u << 22 | 7u << 24;
    FLASH_ACR = 5u | 7u << 8; /* five wait states, caches, prefetch */
    RCC_CFGR = 5u << 10 | 4u << 13;
    if (!board_wait_for(&RCC_CR, 1u << 17, 1u << 17)) {
        board_restart(); /* a dead crystal: never at another clock */
    }
    RCC_CR |= 1u << 24; /* PLLON */
    if (!board_wait_for(&RCC_CR, 1u << 25, 1u << 25)) {
        board_restart();
    }
    RCC_CFGR |= 2u;
    if (!board_wait_for(&RCC_CFGR, 3u << 2, 2u << 2)) {
        board_restart();
    }
}

static inline void board_start_pins(void)
{
    RCC_AHB1ENR |= 1u;
    RCC_AHB2ENR |= 1u << 6;
    RCC_APB1ENR |= 1u | 1u << 17;
    RCC_APB2ENR |= 1u << 4;
    GPIOA_AFRL |= 7u << 8 | 7u << 12;
    GPIOA_AFRH |= 7u << 4 | 7u << 8;
    GPIOA_OSPEEDR |= 2u << 4 | 2u << 18;
    GPIOA_MODER |= 2u << 4 | 2u << 6 | 2u << 18 | 2u << 20;
    USART1->BRR = 42; /* 84 MHz / 2 Mbaud */
    USART2->BRR = 21; /* 42 MHz / 2 Mbaud */
    USART1->CR1 = USART2->CR1 = USART_ON;
}

void board_reset(void)
{
    uint32_t *mark;
    __asm volatile("mov %0, sp" : "=r"(mark));
    for (mark -= 16; mark > _stack_begin;) { /* this function's own frame is left alone */
        *--mark = BOARD_PAINT;
    }
    for (uint32_t *to = _data, *from = _data_load; to < _data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = _bss; to < _bss_end;) {
        *to++ = 0;
    }
    SCB_CPACR |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    board_start_clocks();
    board_start_pins();
    (void)main();
    board_restart();
}

#endif
