/* SPDX-License-Identifier: Apache-2.0 */
/* The registers of the STM32F405 that the box needs, by the names of its reference manual (RM0090) and of the core's. */
#ifndef HYDRO_REGISTERS_H
#define HYDRO_REGISTERS_H

#include <stdint.h>

#define HYDRO_REGISTER(address) (*(volatile uint32_t *)(address))

#define RCC_CR HYDRO_REGISTER(0x40023800u)
#define RCC_PLLCFGR HYDRO_REGISTER(0x40023804u)
#define RCC_CFGR HYDRO_REGISTER(0x40023808u)
#define RCC_AHB1ENR HYDRO_REGISTER(0x40023830u)
#define RCC_AHB2ENR HYDRO_REGISTER(0x40023834u)
#define RCC_APB1ENR HYDRO_REGISTER(0x40023840u)
#define RCC_APB2ENR HYDRO_REGISTER(0x40023844u)
#define FLASH_ACR HYDRO_REGISTER(0x40023C00u)
#define GPIOA_MODER HYDRO_REGISTER(0x40020000u)
#define GPIOA_OSPEEDR HYDRO_REGISTER(0x40020008u)
#define GPIOA_AFRL HYDRO_REGISTER(0x40020020u)
#define GPIOA_AFRH HYDRO_REGISTER(0x40020024u)
#define RNG_CR HYDRO_REGISTER(0x50060800u)
#define RNG_SR HYDRO_REGISTER(0x50060804u)
#define RNG_DR HYDRO_REGISTER(0x50060808u)
#define IWDG_KR HYDRO_REGISTER(0x40003000u)
#define IWDG_PR HYDRO_REGISTER(0x40003004u)
#define IWDG_RLR HYDRO_REGISTER(0x40003008u)

typedef struct {
    volatile uint32_t SR, DR, BRR, CR1, CR2, CR3;
} board_usart;

#define USART1 ((board_usart *)0x40011000u)
#define USART2 ((board_usart *)0x40004400u)
#define USART_RXNE (1u << 5) /* of SR, and its interrupt's bit in CR1 */
#define USART_TXE (1u << 7)
#define USART_ON (1u << 13 | 1u << 3 | 1u << 2 | USART_RXNE) /* UE TE RE RXNEIE */

#define SYST_CSR HYDRO_REGISTER(0xE000E010u)
#define SYST_RVR HYDRO_REGISTER(0xE000E014u)
#define SYST_CVR HYDRO_REGISTER(0xE000E018u)
#define NVIC_ISER ((volatile uint32_t *)0xE000E100u)
#define NVIC_ISPR ((volatile uint32_t *)0xE000E200u)
#define NVIC_IPR ((volatile uint8_t *)0xE000E400u)
#define SCB_ICSR HYDRO_REGISTER(0xE000ED04u)
#define SCB_AIRCR HYDRO_REGISTER(0xE000ED0Cu)
#define SCB_PENDSV_PRIORITY (*(volatile uint8_t *)0xE000ED22u)
#define SCB_CPACR HYDRO_REGISTER(0xE000ED88u)

enum { IRQ_USART1 = 37, IRQ_USART2 = 38, IRQ_COUNT = 82 };

#endif
