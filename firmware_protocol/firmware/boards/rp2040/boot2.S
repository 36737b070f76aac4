/* Second stage of the boot (data sheet 2.8.1.3). The boot ROM copies the first 256 bytes of the flash to the end of SRAM5,
 * checks their CRC and calls them there. They set the flash interface up for the plain read command, 03h with a 24-bit
 * address, which every serial flash has, so that the flash can be read as memory; then the program starts.
 *
 * Slow and sure: the flash gets an eighth of the processor's clock, 25 MHz at most, which every flash takes for that
 * command. It is read once, when the program is copied to RAM. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ SSI, 0x18000000 /* 4.10.13 */
    .equ SSI_CTRLR0, 0x00
    .equ SSI_CTRLR1, 0x04
    .equ SSI_SSIENR, 0x08
    .equ SSI_BAUDR, 0x14
    .equ SSI_SPI_CTRLR0, 0xF4
    .equ VTOR, 0xE000ED08
    .equ PROGRAM, 0x10000100 /* its vectors: stack, start */

    .section .boot2, "ax"
    .thumb_func
boot2:
    push {lr}
    ldr r0, =SSI
    movs r1, #0
    str r1, [r0, #SSI_SSIENR] /* off: only then may it be changed */
    movs r2, #8
    str r2, [r0, #SSI_BAUDR]
    ldr r2, =(31 << 16) | (3 << 8) /* one line, words of 32 bits, reading as from an EEPROM */
    str r2, [r0, #SSI_CTRLR0]
    str r1, [r0, #SSI_CTRLR1] /* one word for each access */
    ldr r2, =(0x03 << 24) | (2 << 8) | (6 << 2) /* command 03h of 8 bits, address of 6 nibbles, no wait */
    ldr r3, =SSI + SSI_SPI_CTRLR0
    str r2, [r3]
    movs r2, #1
    str r2, [r0, #SSI_SSIENR]
    pop {r0}
    cmp r0, #0 /* the boot ROM's own call has no way back; a debugger's has */
    beq 1f
    bx r0
1:  ldr r0, =PROGRAM
    ldr r1, =VTOR
    str r0, [r1]
    ldr r1, [r0]
    ldr r2, [r0, #4]
    msr msp, r1
    bx r2
    .ltorg

    .org 252
    .word 0xF7E1C9EF /* CRC-32 of the 252 bytes before, polynomial 0x04C11DB7, nothing reflected or inverted at the end; tested */
