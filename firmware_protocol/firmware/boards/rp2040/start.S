/* From reset to main: start the clocks, copy the program to RAM, check it, clear what starts as zero. Runs from the flash.
 *
 * The clocks come first: on the boot's ring oscillator the copy alone took 0.7 s. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ VTOR, 0xE000ED08 /* 2.4.8 */
    .equ WATCHDOG_SCRATCH1, 0x40058010 /* 4.7.6 */
    .equ BOOTLOADER_WANTED, 0x544F4F42 /* reset.c */
    .equ ROM_TABLE, 0x14 /* 2.8.3: half words: table of functions, the function that searches it */
    .equ ROM_SEARCH, 0x18
    .equ ROM_RESET_TO_USB_BOOT, 'U' | 'B' << 8 /* 2.8.3.1.6 */

    .section .start_vectors, "a"
    .word stack_top
    .word start

    .section .start, "ax"
    .global start
    .thumb_func
start:
    cpsid i
    ldr r0, =WATCHDOG_SCRATCH1
    ldr r1, [r0]
    movs r2, #0
    str r2, [r0]
    ldr r2, =BOOTLOADER_WANTED
    cmp r1, r2
    beq bootloader
    bl clocks_start
    ldr r0, =ram_image
    ldr r1, =ram_begins
    ldr r2, =ram_ends
1:  ldmia r0!, {r3-r6} /* whole lines of 16 bytes: the linker script aligns both ends */
    stmia r1!, {r3-r6}
    cmp r1, r2
    blo 1b
    bl image_is_whole
    cmp r0, #0
    beq bootloader
    ldr r1, =bss_begins
    ldr r2, =bss_ends
    movs r3, #0
    movs r4, #0
    movs r5, #0
    movs r6, #0
    b 3f
2:  stmia r1!, {r3-r6}
3:  cmp r1, r2
    blo 2b
    ldr r0, =VTOR
    ldr r1, =ram_begins
    str r1, [r0]
    dsb
    isb
    ldr r0, =main
    blx r0
4:  b 4b

/* The boot ROM's drive: asked for, or because there is nothing that may run. No pin is driven here. */
    .thumb_func
bootloader:
    movs r0, #ROM_TABLE
    ldrh r0, [r0]
    movs r2, #ROM_SEARCH
    ldrh r2, [r2]
    ldr r1, =ROM_RESET_TO_USB_BOOT
    blx r2
    mov r2, r0
    movs r0, #0 /* no pin shows activity */
    movs r1, #0 /* both of its interfaces */
    blx r2
5:  b 5b
    .ltorg
