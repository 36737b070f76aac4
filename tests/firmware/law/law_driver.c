/* Runs the law over a table of inputs: as a function of the shared library, and as a program for the sanitisers, which
 * reads cases (parameters, a number of ticks, inputs) and writes the verdict of the check and what each tick left. */
#include <stdio.h>
#include <stdlib.h>

#include "excitation.h"
#include "law.h"

typedef struct {
    law_output out;
    float velocity, limited;
    int32_t velocity_fixed;
    uint32_t window;
} driver_tick;

size_t driver_size(int of);
void driver_run(law_state *s, const law_parameters *p, const law_input *in, size_t ticks, driver_tick *out);
int main(void);

size_t driver_size(int of)
{
    const size_t sizes[] = {sizeof(law_parameters), sizeof(law_state), sizeof(law_input), sizeof(law_output),
                            sizeof(driver_tick), sizeof(law_excitation_work)};
    return sizes[of];
}

void driver_run(law_state *s, const law_parameters *p, const law_input *in, size_t ticks, driver_tick *out)
{
    size_t k;
    for (k = 0; k < ticks; k++) {
        out[k].out = law_tick(s, p, &in[k]);
        if (law_inside(p, in[k].count) != ((out[k].out.flags & LAW_INSIDE) != 0))
            abort(); /* both say where the handle is */
        out[k].velocity = s->velocity;
        out[k].limited = s->limited;
        out[k].velocity_fixed = s->velocity_fixed;
        out[k].window = s->window;
        if (law_is_free(p, in[k].count) != (!p->bilateral && (out[k].out.flags & LAW_INSIDE) == 0))
            abort(); /* a bilateral wall is felt everywhere */
    }
}

/* Memory for the excitation's table, which is worked out; NULL without lines. */
static int16_t *excitation(const law_excitation *p)
{
    law_excitation_work work;
    int16_t *table = p->lines > 0 ? calloc(p->period, sizeof *table) : NULL;
    law_excitation_begin(&work, p, table);
    while (!law_excitation_continue(&work, 1000))
        ;
    return table;
}

int main(void)
{
    law_parameters p;
    uint64_t ticks;

    while (fread(&p, sizeof p, 1, stdin) == 1 && fread(&ticks, sizeof ticks, 1, stdin) == 1) {
        law_input *in = calloc((size_t)ticks + 1, sizeof *in);
        driver_tick *out = calloc((size_t)ticks + 1, sizeof *out);
        const int32_t verdict = (int32_t)law_check(&p);
        law_state s; /* as memory comes */
        if (in == NULL || out == NULL || fread(in, sizeof *in, (size_t)ticks, stdin) != ticks)
            return 2;
        if (verdict == LAW_GOOD) {
            int16_t *table = excitation(&p.excitation);
            law_reset(&s, &p, table);
            driver_run(&s, &p, in, (size_t)ticks, out);
            free(table);
        }
        if (fwrite(&verdict, sizeof verdict, 1, stdout) != 1
            || fwrite(out, sizeof *out, (size_t)ticks, stdout) != ticks)
            return 3;
        free(in);
        free(out);
    }
    return 0;
}
