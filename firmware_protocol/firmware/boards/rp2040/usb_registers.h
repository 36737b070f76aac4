/* The USB controller of the RP2040 as a device: registers and memory that it shares with the processor.
 *
 * RP2040 data sheet, 4.1.2 (architecture, DPSRAM), 4.1.4 (registers). Under test, USB_ELSEWHERE puts functions in the
 * place of the accesses, behind which a model of the controller stands. */
#ifndef HR_RP2040_USB_REGISTERS_H
#define HR_RP2040_USB_REGISTERS_H

#include <stddef.h>
#include <stdint.h>

#define USB_MEMORY 0x50100000u
#define USB_REGISTERS 0x50110000u
#define USB_MEMORY_BYTES 4096u
#define USB_INTERRUPT_NUMBER 5u

/* Offsets in the shared memory (4.1.2.5, device mode). */
#define USB_AT_SETUP 0x000u
#define USB_AT_ENDPOINT_0_BUFFER 0x100u
#define USB_AT_BUFFERS 0x180u
#define USB_AT_ENDPOINT_CONTROL(number, out) (8u * (number) + ((out) ? 4u : 0u)) /* not of endpoint 0 */
#define USB_AT_BUFFER_CONTROL(number, out) (0x80u + 8u * (number) + ((out) ? 4u : 0u))

/* Endpoint control (4.1.2.5.2). */
#define USB_ENDPOINT_ENABLE (UINT32_C(1) << 31)
#define USB_ENDPOINT_TWO_BUFFERS (UINT32_C(1) << 30)
#define USB_ENDPOINT_EACH_BUFFER (UINT32_C(1) << 29) /* raises its bit of BUFF_STATUS for every buffer */
#define USB_ENDPOINT_TYPE(type) ((uint32_t)(type) << 26)

/* Buffer control (4.1.2.5.3), one half word a buffer. */
#define USB_BUFFER_FULL (1u << 15)
#define USB_BUFFER_DATA1 (1u << 13)
#define USB_BUFFER_SELECT_FIRST (1u << 12) /* of buffer 0 alone */
#define USB_BUFFER_STALL (1u << 11)        /* of both, in the half word of buffer 0 */
#define USB_BUFFER_AVAILABLE (1u << 10)    /* the controller's while set */
#define USB_BUFFER_LENGTH 0x3FFu

/* Registers (4.1.4). */
enum usb_register {
    USB_ADDR_ENDP = 0x00,
    USB_MAIN_CTRL = 0x40,
    USB_SOF_RD = 0x48,
    USB_SIE_CTRL = 0x4C,
    USB_SIE_STATUS = 0x50,
    USB_BUFF_STATUS = 0x58,
    USB_EP_ABORT = 0x60,
    USB_EP_ABORT_DONE = 0x64,
    USB_EP_STALL_ARM = 0x68,
    USB_MUXING = 0x74,
    USB_PWR = 0x78,
    USB_INTE = 0x90,
    USB_INTS = 0x98,
};

#define USB_MAIN_CTRL_ENABLE (1u << 0)
#define USB_SIE_CTRL_EACH_BUFFER_OF_0 (UINT32_C(1) << 29)
#define USB_SIE_CTRL_PULL_UP (UINT32_C(1) << 16)
#define USB_SIE_STATUS_BUS_RESET (UINT32_C(1) << 19)
#define USB_SIE_STATUS_SETUP (UINT32_C(1) << 17)
#define USB_SIE_STATUS_RESUME (1u << 11)
#define USB_SIE_STATUS_SUSPENDED (1u << 4)
#define USB_MUXING_TO_PHY (1u << 0)
#define USB_MUXING_SOFTCON (1u << 3)
#define USB_PWR_VBUS_DETECT (1u << 3)
#define USB_PWR_VBUS_OVERRIDE (1u << 2)
#define USB_INT_SOF (UINT32_C(1) << 17)
#define USB_INT_SETUP (UINT32_C(1) << 16)
#define USB_INT_RESUME (1u << 15)
#define USB_INT_SUSPEND (1u << 14)
#define USB_INT_BUS_RESET (1u << 12)
#define USB_INT_BUFFER (1u << 4)

/* A bit of BUFF_STATUS, EP_ABORT and EP_ABORT_DONE. */
#define USB_BIT(number, out) (UINT32_C(1) << (2u * (number) + ((out) ? 1u : 0u)))

#ifdef USB_ELSEWHERE

uint32_t usb_get(enum usb_register at);
void usb_put(enum usb_register at, uint32_t value);
uint32_t usb_memory_get(size_t at);
void usb_memory_put(size_t at, uint32_t value);
uint16_t usb_memory_get_half(size_t at);
void usb_memory_put_half(size_t at, uint16_t value);
uint8_t usb_memory_get_byte(size_t at);
void usb_wait_for_controller(void);
uint32_t usb_now_us(void);
void usb_hardware_start(void);
void usb_pend(void);

#else

#define AT_32(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define AT_16(address) (*(volatile uint16_t *)(uintptr_t)(address))
#define AT_8(address) (*(volatile uint8_t *)(uintptr_t)(address))

/* 2.14.3, 2.19, 4.6.5 and the ARMv6-M architecture's NVIC. */
#define TIMER_TIMERAWL 0x40054028u
#define RESETS_RESET_SET 0x4000E000u
#define RESETS_RESET_CLEAR 0x4000F000u
#define RESETS_RESET_DONE 0x4000C008u
#define RESETS_USBCTRL (UINT32_C(1) << 24)
#define NVIC_ISER 0xE000E100u
#define NVIC_ISPR 0xE000E200u
#define NVIC_IPR(number) (0xE000E400u + ((number) & ~3u))

static inline uint32_t usb_get(enum usb_register at)
{
    return AT_32(USB_REGISTERS + (uint32_t)at);
}

static inline void usb_put(enum usb_register at, uint32_t value)
{
    AT_32(USB_REGISTERS + (uint32_t)at) = value;
}

static inline uint32_t usb_memory_get(size_t at)
{
    return AT_32(USB_MEMORY + at);
}

static inline void usb_memory_put(size_t at, uint32_t value)
{
    AT_32(USB_MEMORY + at) = value;
}

static inline uint16_t usb_memory_get_half(size_t at)
{
    return AT_16(USB_MEMORY + at);
}

static inline void usb_memory_put_half(size_t at, uint16_t value)
{
    AT_16(USB_MEMORY + at) = value;
}

static inline uint8_t usb_memory_get_byte(size_t at)
{
    return AT_8(USB_MEMORY + at);
}

/* The controller runs at 48 MHz and must have seen length and PID before it sees a buffer that is available
 * (4.1.2.5.1, "Concurrent access"): five of its cycles in ours, at 200 MHz. */
static inline void usb_wait_for_controller(void)
{
    for (int i = 0; i < 4; i++)
        __asm__ volatile("nop\n nop\n nop");
}

static inline uint32_t usb_now_us(void)
{
    return AT_32(TIMER_TIMERAWL);
}

/* Out of a reset, whatever ran before; its interrupt allowed, below every other that matters. */
static inline void usb_hardware_start(void)
{
    AT_32(RESETS_RESET_SET) = RESETS_USBCTRL;
    AT_32(RESETS_RESET_CLEAR) = RESETS_USBCTRL;
    while ((AT_32(RESETS_RESET_DONE) & RESETS_USBCTRL) == 0)
        ;
    AT_32(NVIC_IPR(USB_INTERRUPT_NUMBER)) |= UINT32_C(0xC0) << 8u * (USB_INTERRUPT_NUMBER % 4u);
    AT_32(NVIC_ISER) = UINT32_C(1) << USB_INTERRUPT_NUMBER;
}

/* Have usb_interrupt called as soon as nothing more urgent runs. */
static inline void usb_pend(void)
{
    AT_32(NVIC_ISPR) = UINT32_C(1) << USB_INTERRUPT_NUMBER;
}

#endif

#endif
