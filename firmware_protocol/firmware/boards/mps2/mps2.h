/* What the files of this port share. */
#ifndef HR_MPS2_H
#define HR_MPS2_H

/* Of the processor after reset. */
void start(void);

/* The SysTick exception. */
void tick(void);

int main(void);

#endif
