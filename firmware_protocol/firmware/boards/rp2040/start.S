/* From reset to main: copy the program to RAM, clear what starts as zero. Runs from the flash. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ VTOR, 0xE000ED08 /* 2.4.8 */

    .section .start_vectors, "a"
    .word stack_top
    .word start

    .section .start, "ax"
    .global start
    .thumb_func
start:
    cpsid i
    ldr r0, =ram_image
    ldr r1, =ram_begins
    ldr r2, =ram_ends
1:  ldmia r0!, {r3-r6} /* whole lines of 16 bytes: the linker script aligns both ends */
    stmia r1!, {r3-r6}
    cmp r1, r2
    blo 1b
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
    .ltorg
