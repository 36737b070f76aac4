/* Registers of the RP2040 that the port uses. Numbers of sections are those of the RP2040 data sheet. */
#ifndef RP2040_REGISTERS_H
#define RP2040_REGISTERS_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

/* 2.1.2: the same register, in which a write only sets or only clears the bits that are one. Not for SIO. */
#define SET_BITS(address) REGISTER((address) + 0x2000u)
#define CLEAR_BITS(address) REGISTER((address) + 0x3000u)

/* 2.14 Subsystem resets */
#define RESETS 0x4000C000u
#define RESETS_RESET REGISTER(RESETS + 0x0u)
#define RESETS_DONE REGISTER(RESETS + 0x8u)
#define RESET_ADC (1u << 0)
#define RESET_DMA (1u << 2)
#define RESET_IO_BANK0 (1u << 5)
#define RESET_PADS_BANK0 (1u << 8)
#define RESET_PIO0 (1u << 10)
#define RESET_PIO1 (1u << 11)
#define RESET_PLL_SYS (1u << 12)
#define RESET_PLL_USB (1u << 13)
#define RESET_PWM (1u << 14)
#define RESET_TIMER (1u << 21)
#define RESET_UART0 (1u << 22)
#define RESET_USBCTRL (1u << 24)

/* 2.13 Power-on state machine: what the watchdog resets */
#define PSM_WATCHDOG_SELECT REGISTER(0x40010008u)
#define PSM_OSCILLATORS 0x3u
#define PSM_ALL 0x1FFFFu

/* 2.10.6 Regulator of the core's voltage */
#define REGULATOR REGISTER(0x40064000u)
#define REGULATOR_ON 1u
#define REGULATOR_IN_REGULATION (1u << 12)

/* 2.15.7 Clocks */
#define CLOCKS 0x40008000u
#define CLOCK_REFERENCE_CONTROL REGISTER(CLOCKS + 0x30u)
#define CLOCK_REFERENCE_DIVIDER REGISTER(CLOCKS + 0x34u)
#define CLOCK_REFERENCE_SELECTED REGISTER(CLOCKS + 0x38u)
#define CLOCK_SYSTEM_CONTROL REGISTER(CLOCKS + 0x3Cu)
#define CLOCK_SYSTEM_DIVIDER REGISTER(CLOCKS + 0x40u)
#define CLOCK_SYSTEM_SELECTED REGISTER(CLOCKS + 0x44u)
#define CLOCK_PERIPHERALS_CONTROL REGISTER(CLOCKS + 0x48u)
#define CLOCK_USB_CONTROL REGISTER(CLOCKS + 0x54u)
#define CLOCK_USB_DIVIDER REGISTER(CLOCKS + 0x58u)
#define CLOCK_ADC_CONTROL REGISTER(CLOCKS + 0x60u)
#define CLOCK_ADC_DIVIDER REGISTER(CLOCKS + 0x64u)
#define CLOCK_RESUSCITATION REGISTER(CLOCKS + 0x78u)
#define CLOCK_ENABLE (1u << 11)
#define CLOCK_DIVIDED_BY_ONE (1u << 8)
#define REFERENCE_FROM_CRYSTAL 2u
#define SYSTEM_FROM_REFERENCE 0u
#define SYSTEM_FROM_PLL 1u /* auxiliary source 0 */

/* 2.16 Crystal oscillator */
#define CRYSTAL_CONTROL REGISTER(0x40024000u)
#define CRYSTAL_STATUS REGISTER(0x40024004u)
#define CRYSTAL_STARTUP REGISTER(0x4002400Cu)
#define CRYSTAL_ENABLE_1_TO_15_MHZ 0x00FABAA0u
#define CRYSTAL_STABLE (1u << 31)

/* 2.18 Phase-locked loops */
#define PLL_SYSTEM 0x40028000u
#define PLL_USB 0x4002C000u
#define PLL_CONTROL(pll) REGISTER((pll) + 0x0u)
#define PLL_POWER 0x4u /* down, when a bit is one */
#define PLL_FEEDBACK(pll) REGISTER((pll) + 0x8u)
#define PLL_POST_DIVIDERS(pll) REGISTER((pll) + 0xCu)
#define PLL_LOCKED (1u << 31)
#define PLL_POWER_MAIN (1u << 0)
#define PLL_POWER_POST_DIVIDERS (1u << 3)
#define PLL_POWER_OSCILLATOR (1u << 5)

/* 2.19.6 GPIO */
#define GPIO_CONTROL(pin) REGISTER(0x40014004u + 8u * (pin))
#define GPIO_EVENTS(pin) REGISTER(0x400140F0u + 4u * ((pin) / 8u)) /* also without an interrupt; write one to clear */
#define GPIO_ROSE(pin) (8u << 4u * ((pin) % 8u))
#define GPIO_UART 2u
#define GPIO_PWM 4u
#define GPIO_SIO 5u
#define GPIO_PIO1 7u
#define GPIO_NONE 31u
#define PAD(pin) REGISTER(0x4001C004u + 4u * (pin))
#define PAD_SCHMITT (1u << 1)
#define PAD_PULL_DOWN (1u << 2)
#define PAD_PULL_UP (1u << 3)
#define PAD_4_MA (1u << 4)
#define PAD_INPUT (1u << 6)
#define PAD_OUTPUT_DISABLED (1u << 7)

/* 2.3.1.7 Single-cycle IO */
#define SIO_IN REGISTER(0xD0000004u)
#define SIO_OUT_SET REGISTER(0xD0000014u)
#define SIO_OUT_CLEAR REGISTER(0xD0000018u)
#define SIO_DRIVE_SET REGISTER(0xD0000024u)

/* 2.5.7 DMA */
#define DMA(channel) (0x50000000u + 0x40u * (channel))
#define DMA_FROM(channel) REGISTER(DMA(channel) + 0x00u)
#define DMA_TO(channel) REGISTER(DMA(channel) + 0x04u)
#define DMA_COUNT(channel) REGISTER(DMA(channel) + 0x08u)
#define DMA_CONTROL_START(channel) REGISTER(DMA(channel) + 0x0Cu) /* a write starts the channel */
#define DMA_CONTROL(channel) REGISTER(DMA(channel) + 0x10u)       /* AL1_CTRL: does not */
#define DMA_COUNT_START(channel) REGISTER(DMA(channel) + 0x1Cu)   /* AL1_TRANS_COUNT_TRIG */
#define DMA_FROM_START(channel) REGISTER(DMA(channel) + 0x3Cu)    /* AL3_READ_ADDR_TRIG */
#define DMA_ENABLE (1u << 0)
#define DMA_BYTES (0u << 2)
#define DMA_WORDS (2u << 2)
#define DMA_STEP_FROM (1u << 4)
#define DMA_STEP_TO (1u << 5)
#define DMA_RING_FROM(bits) ((bits) << 6)
#define DMA_RING_TO(bits) ((bits) << 6 | 1u << 10)
#define DMA_THEN(channel) ((channel) << 11) /* itself: nothing */
#define DMA_WHEN(request) ((request) << 15)
#define DMA_QUIET (1u << 21)
#define DMA_BUSY (1u << 24)
#define REQUEST_PIO0_RECEIVED(machine) (4u + (machine))
#define REQUEST_UART0_TRANSMIT 20u
#define REQUEST_UART0_RECEIVE 21u
#define REQUEST_ALWAYS 0x3Fu

/* 3.7 PIO */
#define PIO0 0x50200000u
#define PIO_CONTROL REGISTER(PIO0 + 0x0u)
#define PIO_FIFO_STATUS REGISTER(PIO0 + 0x4u)
#define PIO_RECEIVED_NONE(machine) (1u << (8u + (machine)))
#define PIO_RECEIVED(machine) REGISTER(PIO0 + 0x20u + 4u * (machine))
#define PIO_FLAGS REGISTER(PIO0 + 0x30u) /* write one to clear */
#define PIO_MEMORY(index) REGISTER(PIO0 + 0x48u + 4u * (index))
#define PIO_DIVIDER(machine) REGISTER(PIO0 + 0xC8u + 0x18u * (machine))
#define PIO_EXECUTION(machine) REGISTER(PIO0 + 0xCCu + 0x18u * (machine))
#define PIO_SHIFTING(machine) REGISTER(PIO0 + 0xD0u + 0x18u * (machine))
#define PIO_INSTRUCTION(machine) REGISTER(PIO0 + 0xD8u + 0x18u * (machine))
#define PIO_PINS(machine) REGISTER(PIO0 + 0xDCu + 0x18u * (machine))
#define PIO_NOT_DIVIDED (1u << 16)
#define PIO_JUMP_PIN(pin) ((pin) << 24)
#define PIO_WRAP(bottom, top) ((top) << 12 | (bottom) << 7)
#define PIO_PUSH_ALL_32 (1u << 16) /* automatically, when 32 bits are in */
#define PIO_SHIFT_IN_RIGHT (1u << 18)
#define PIO_SHIFT_OUT_RIGHT (1u << 19)
#define PIO_IN_FROM(pin) ((pin) << 15)
#define PIO_SIDE_SET_FROM(pin, count) ((count) << 29 | (pin) << 10)
#define PIO_SET_FROM(pin, count) ((count) << 26 | (pin) << 5)
#define PIO_OUT_FROM(pin, count) ((count) << 20 | (pin))
#define PIO1 0x50300000u /* its first machine alone */
#define PIO1_CONTROL REGISTER(PIO1 + 0x0u)
#define PIO1_DEBUG REGISTER(PIO1 + 0x8u) /* write one to clear */
#define PIO1_NOTHING_TO_SEND (1u << 24)
#define PIO1_SEND REGISTER(PIO1 + 0x10u)
#define PIO1_MEMORY(index) REGISTER(PIO1 + 0x48u + 4u * (index))
#define PIO1_DIVIDER REGISTER(PIO1 + 0xC8u)
#define PIO1_EXECUTION REGISTER(PIO1 + 0xCCu)
#define PIO1_SHIFTING REGISTER(PIO1 + 0xD0u)
#define PIO1_INSTRUCTION REGISTER(PIO1 + 0xD8u)
#define PIO1_PINS REGISTER(PIO1 + 0xDCu)

/* 4.2.7 UART */
#define UART0 0x40034000u
#define UART_DATA (UART0 + 0x0u)
#define UART_DIVIDER REGISTER(UART0 + 0x24u)
#define UART_DIVIDER_64THS REGISTER(UART0 + 0x28u)
#define UART_LINE REGISTER(UART0 + 0x2Cu)
#define UART_CONTROL REGISTER(UART0 + 0x30u)
#define UART_DMA REGISTER(UART0 + 0x48u)
#define UART_8_BITS_WITH_FIFOS (3u << 5 | 1u << 4)
#define UART_ON_BOTH_WAYS (1u << 9 | 1u << 8 | 1u << 0)
#define UART_DMA_BOTH_WAYS 3u

/* 4.5.3 PWM */
#define PWM(slice) (0x40050000u + 0x14u * (slice))
#define PWM_CONTROL(slice) REGISTER(PWM(slice) + 0x0u)
#define PWM_DIVIDER(slice) REGISTER(PWM(slice) + 0x4u)
#define PWM_COUNTER(slice) REGISTER(PWM(slice) + 0x8u)
#define PWM_COMPARE(slice) REGISTER(PWM(slice) + 0xCu)
#define PWM_TOP(slice) REGISTER(PWM(slice) + 0x10u)
#define PWM_WRAPPED REGISTER(0x400500A4u) /* write one to clear */
#define PWM_INTERRUPTS REGISTER(0x400500A8u)
#define PWM_ON 1u
#define PWM_DIVIDED_BY(sixteenths) (sixteenths)

/* 4.10.13 SSI: the flash */
#define SSI 0x18000000u
#define SSI_CONTROL REGISTER(SSI + 0x0u)
#define SSI_ENABLE REGISTER(SSI + 0x8u) /* only while it is off may the others be changed */
#define SSI_SELECT REGISTER(SSI + 0x10u)
#define SSI_RECEIVED REGISTER(SSI + 0x24u)
#define SSI_DATA REGISTER(SSI + 0x60u)
#define SSI_BYTES_BOTH_WAYS (7u << 16)

/* 4.6.5 Timer */
#define TIMER_RAW_LOW 0x40054028u

/* 4.7.6 Watchdog */
#define WATCHDOG 0x40058000u
#define WATCHDOG_CONTROL REGISTER(WATCHDOG + 0x0u)
#define WATCHDOG_LOAD REGISTER(WATCHDOG + 0x4u)
#define WATCHDOG_REASON REGISTER(WATCHDOG + 0x8u)
#define WATCHDOG_SCRATCH0 REGISTER(WATCHDOG + 0xCu)
#define WATCHDOG_SCRATCH1 REGISTER(WATCHDOG + 0x10u)
#define WATCHDOG_SCRATCH2 REGISTER(WATCHDOG + 0x14u)
#define WATCHDOG_TICK REGISTER(WATCHDOG + 0x2Cu)
#define WATCHDOG_ENABLE (1u << 30)
#define WATCHDOG_TRIGGER (1u << 31)
#define WATCHDOG_TICK_ENABLE (1u << 9)

/* 4.9.6 ADC */
#define ADC_CONTROL REGISTER(0x4004C000u)
#define ADC_RESULT REGISTER(0x4004C004u)
#define ADC_DIVIDER REGISTER(0x4004C010u)
#define ADC_ON 1u
#define ADC_START_MANY (1u << 3)
#define ADC_READY (1u << 8)
#define ADC_FIRST_PIN 26u

/* 2.4.5 and 2.4.8: interrupts of the processor (Armv6-M Architecture Reference Manual, B3.4) */
#define INTERRUPTS_ENABLE REGISTER(0xE000E100u)
#define INTERRUPTS_FORGET REGISTER(0xE000E280u)
#define INTERRUPT_PRIORITY(group) REGISTER(0xE000E400u + 4u * (group)) /* four interrupts each */
#define INTERRUPT_PWM_WRAP 4u

#endif
