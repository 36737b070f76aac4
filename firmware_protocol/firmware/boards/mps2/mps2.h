/* Declarations that the files of this port use together. */
#ifndef HR_MPS2_H
#define HR_MPS2_H

/* Clock frequency of the processor after reset (Hz). */
void start(void);

/* The SysTick exception. */
void tick(void);

int main(void);

#endif
