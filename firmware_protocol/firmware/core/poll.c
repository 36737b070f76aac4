#include "poll.h"

#include "answers.h"

static void take_frame(struct device *device, const uint8_t *raw, size_t count)
{
    const struct verdict verdict = connection_judge(&device->connection, raw, count);
    if (verdict.kind == VERDICT_COMMAND)
        device_command(device, raw);
    else if (verdict.kind != VERDICT_DROP)
        answer(device, raw, count, &verdict);
}

static size_t take_bytes(struct device *device)
{
    uint8_t bytes[HR_POLL_BYTES];
    struct connection *connection = &device->connection;
    const bool running = device_is_armed(device) && device_runs_law(device);
    const size_t most = running ? HR_POLL_BYTES_RUNNING : sizeof bytes;
    const size_t count = device->hal->link_read(device->hal->context, bytes, most);
    device->received_at = device->hal->time(device->hal->context);
    for (size_t i = 0; i < count; i++) {
        const size_t raw = splitter_take(&connection->splitter, bytes[i], &connection->counters);
        if (raw > 0)
            take_frame(device, splitter_raw(&connection->splitter), raw);
    }
    return count;
}

size_t device_poll(struct device *device)
{
    size_t count = 0;
    device->unpolled = 0;
    if (!device_send_some(device, HR_BYTES_A_POLL)) {
        if (device_is_changing(device))
            answer_more(device);
        else
            count = take_bytes(device);
    }
    if (device->leaves_at != 0 && device->time >= device->leaves_at)
        device->hal->enter_bootloader(device->hal->context);
    if (device_is_preparing(device))
        renderer_prepare(&device->renderer, HR_POLL_COSINES);
    return count;
}
