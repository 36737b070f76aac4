#include "lockstep.h"

int lockstep_drive(struct host *host, struct lockstep *lockstep)
{
    const uint32_t cuts = host->cuts;
    host_set_inputs(host, (uint8_t)lockstep->inputs);
    const int current = host_drive(host);
    lockstep->cuts = host->cuts - cuts;
    return current;
}

int lockstep_sample(struct host *host, struct lockstep *lockstep)
{
    const uint32_t cuts = host->cuts;
    const uint64_t time = host->device.due;
    const uint64_t age = (uint64_t)lockstep->edge_age;
    host_set_world(host, time, (int32_t)lockstep->count, age < time ? time - age : 0, (int16_t)lockstep->measured,
                   (uint8_t)lockstep->inputs);
    host_set_index(host, (uint32_t)lockstep->index_edges, (int32_t)lockstep->index_count);
    host_sample(host);
    host_report(host);
    lockstep->cuts = host->cuts - cuts;
    lockstep->due = (int64_t)host->device.due;
    lockstep->sample_index = host->device.sample_index;
    lockstep->session = host->device.connection.session;
    lockstep->time = (int64_t)time;
    return (int)host->output_count;
}

int lockstep_receive(struct host *host, struct lockstep *lockstep)
{
    const uint32_t cuts = host->cuts, rate = host->rate;
    const bool enabled = host->enabled;
    host_set_inputs(host, (uint8_t)lockstep->inputs);
    host_set_clock(host, (uint64_t)lockstep->received_at, 0);
    host_receive(host, (const uint8_t *)(uintptr_t)lockstep->bytes, (size_t)lockstep->byte_count);
    lockstep->cuts = host->cuts - cuts;
    lockstep->rate_changed = host->rate != rate;
    lockstep->switched_on = host->enabled && !enabled;
    lockstep->due = (int64_t)host->device.due;
    lockstep->session = host->device.connection.session;
    return (int)host->output_count;
}
