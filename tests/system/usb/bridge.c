/* A USB device for a real libusb without a kernel: usbfs by umockdev, bulk packets through a socket.
 *
 * umockdev's preload library sends every ioctl of a client on the device node here. This program answers those of
 * usbfs that libusb makes, keeps the queue of transfers (URBs), and moves their packets to and from a device program
 * over a connected SOCK_SEQPACKET, one message a packet. Lines on standard input make what goes wrong on a cable.
 *
 * libusb sleeps in poll(2) until the descriptor is writable: usbfs says so when a transfer can be reaped. umockdev's
 * node is a file, which is always writable: the slave of a pseudo-terminal takes its place, whose output is stopped
 * (TCOOFF) while nothing can be reaped, and started (TCOON) when something can. Closing the master hangs the slave up,
 * which poll shows as POLLERR: what usbfs shows when the device is pulled.
 *
 * usage: bridge SOCKET_FD DESCRIPTORS STRING0 STRING1 ...   (descriptors in hex; SOCKET_FD inherited)
 * It prints "root DIRECTORY" once; then for each command line "ok NANOSECONDS" (CLOCK_MONOTONIC) or "error".
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <umockdev.h>

#define URBS 128
#define STRINGS 8
#define IN_ENDPOINT 0x80

struct text { unsigned char bytes[256]; int length; };
struct entry { /* a submitted transfer; its address in the client's memory is in urb */
    UMockdevIoctlData *urb, *buffer;
    UMockdevIoctlClient *owner;
};
struct queue { struct entry entries[URBS]; int count; };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct queue pending, finished;
static struct text strings[STRINGS];
static int string_count;
static const char *descriptors;
static UMockdevTestbed *testbed;
static int device = -1;          /* socket to the device program */
static int wake = -1;            /* eventfd: the queue has changed */
static int terminal = -1;        /* our descriptor of the node's terminal */
static int master = -1;          /* and the other end of it */
static int present, number = 1;  /* plugged in; device number on the bus */
static char path[256], node[64];
static int stopped_in, stopped_out; /* endpoint halted until CLEAR_HALT */
static int refuse_in, refuse_out;   /* one transfer has still to learn of it; the others stay where they are */
static int silent, short_writes, busy, asked, cleared, detached, attached, overflow_next, broken_next;
static UMockdevIoctlClient *claimer;
static long long happened; /* when the last command took effect */
static char driver[32]; /* kernel driver that holds the interface, or "" */

static struct usbdevfs_urb *urb_of(struct entry *entry) { return (struct usbdevfs_urb *)entry->urb->data; }
static int is_in(struct entry *entry) { return urb_of(entry)->endpoint & IN_ENDPOINT; }

static long long now_ns(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec * 1000000000LL + time.tv_nsec;
}

/* Make poll(2) on the node say what usbfs would say. */
static void show_ready(void)
{
    if (terminal >= 0)
        tcflow(terminal, finished.count ? TCOON : TCOOFF);
}

static void push(struct queue *queue, struct entry entry)
{
    if (queue->count == URBS)
        abort();
    queue->entries[queue->count++] = entry;
}

static struct entry take(struct queue *queue, int index)
{
    struct entry entry = queue->entries[index];
    memmove(&queue->entries[index], &queue->entries[index + 1], sizeof entry * (--queue->count - index));
    return entry;
}

static void finish(int index, int status, int length)
{
    struct entry entry = take(&pending, index);
    urb_of(&entry)->status = status;
    urb_of(&entry)->actual_length = length;
    push(&finished, entry);
    show_ready();
}

static int first(int in)
{
    for (int i = 0; i < pending.count; i++)
        if (!!is_in(&pending.entries[i]) == in)
            return i;
    return -1;
}

/* Complete a transfer of one direction with an error; 0 when none waits. */
static int fail(int in, int status)
{
    int index = first(in);
    if (index < 0)
        return 0;
    finish(index, status, 0);
    return 1;
}

/* Move what can be moved: packets out to the device, packets in from it. */
static void move(void)
{
    int index;
    if (!present)
        return;
    if (refuse_in)
        refuse_in = !fail(1, -EPIPE);
    if (refuse_out)
        refuse_out = !fail(0, -EPIPE);
    if (silent)
        return;
    while (!stopped_out && (index = first(0)) >= 0) {
        struct entry *entry = &pending.entries[index];
        int length = urb_of(entry)->buffer_length / (short_writes ? 2 : 1);
        if (send(device, entry->buffer ? entry->buffer->data : NULL, length, MSG_DONTWAIT | MSG_NOSIGNAL) < 0)
            break;
        finish(index, 0, length);
    }
    while (!stopped_in && (index = first(1)) >= 0) {
        struct entry *entry = &pending.entries[index];
        int room = urb_of(entry)->buffer_length;
        unsigned char packet[65536];
        int length = recv(device, packet, sizeof packet, MSG_DONTWAIT);
        if (length <= 0)
            break;
        if (overflow_next || length > room) {
            overflow_next = 0;
            finish(index, -EOVERFLOW, 0);
            continue;
        }
        if (broken_next) {
            broken_next = 0;
            finish(index, -EPROTO, 0);
            continue;
        }
        memcpy(entry->buffer->data, packet, length);
        finish(index, 0, length);
    }
}

/* Answer a control request in its buffer: eight bytes of SETUP, then the data. */
static void control(struct entry entry)
{
    unsigned char *setup = entry.buffer->data;
    int room = urb_of(&entry)->buffer_length - 8, length = 0, status = 0;
    if (setup[1] == 6 && setup[3] == 3 && setup[2] < string_count) {
        struct text *text = &strings[setup[2]];
        length = text->length < room ? text->length : room;
        memcpy(setup + 8, text->bytes, length);
    } else if (setup[1] == 6) {
        status = -EPIPE;
    }
    urb_of(&entry)->status = status;
    urb_of(&entry)->actual_length = length;
    push(&finished, entry);
    show_ready();
}

static int submit(UMockdevIoctlClient *client, UMockdevIoctlData *data)
{
    struct usbdevfs_urb *urb = (struct usbdevfs_urb *)data->data;
    struct entry entry = {g_object_ref(data), NULL, client};
    entry.buffer = umockdev_ioctl_data_resolve(data, offsetof(struct usbdevfs_urb, buffer), urb->buffer_length, NULL);
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL) {
        control(entry);
        return 0;
    }
    push(&pending, entry);
    move();
    return 0;
}

static int discard(unsigned long address)
{
    for (int i = 0; i < pending.count; i++)
        if (pending.entries[i].urb->client_addr == address) {
            finish(i, -ENOENT, 0);
            return 0;
        }
    return EINVAL;
}

/* Index of the first entry that a client has in a queue, or -1. */
static int owned(struct queue *queue, UMockdevIoctlClient *client)
{
    for (int i = 0; i < queue->count; i++)
        if (queue->entries[i].owner == client)
            return i;
    return -1;
}

static int reap(UMockdevIoctlClient *client, UMockdevIoctlData *into)
{
    int index = owned(&finished, client);
    if (index < 0)
        return present ? EAGAIN : ENODEV;
    struct entry entry = take(&finished, index);
    umockdev_ioctl_data_set_ptr(into, 0, entry.urb);
    g_object_unref(entry.urb);
    show_ready();
    return 0;
}

static void forget(UMockdevIoctlClient *client)
{
    int index;
    while ((index = owned(&pending, client)) >= 0)
        g_object_unref(take(&pending, index).urb);
    while ((index = owned(&finished, client)) >= 0)
        g_object_unref(take(&finished, index).urb);
    if (claimer == client)
        claimer = NULL;
    show_ready();
}

/* Return the errno of one ioctl, 0 when it is granted. */
static int answer(UMockdevIoctlClient *client)
{
    unsigned long request = umockdev_ioctl_client_get_request(client);
    UMockdevIoctlData *argument = umockdev_ioctl_client_get_arg(client), *data = NULL;
    if (request == USBDEVFS_DISCARDURB)
        return discard(*(unsigned long *)argument->data);
    if (_IOC_SIZE(request))
        data = umockdev_ioctl_data_resolve(argument, 0, _IOC_SIZE(request), NULL);
    if (request == USBDEVFS_REAPURB || request == USBDEVFS_REAPURBNDELAY)
        return reap(client, data);
    if (!present)
        return ENODEV;
    switch (request) {
    case USBDEVFS_GET_CAPABILITIES:
        *(unsigned int *)data->data = USBDEVFS_CAP_ZERO_PACKET | USBDEVFS_CAP_BULK_CONTINUATION |
            USBDEVFS_CAP_NO_PACKET_SIZE_LIM | USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
        return 0;
    case USBDEVFS_SUBMITURB:
        return submit(client, data);
    case USBDEVFS_CLAIMINTERFACE:
        if (busy || driver[0] || (claimer && claimer != client))
            return EBUSY;
        claimer = client;
        return 0;
    case USBDEVFS_RELEASEINTERFACE:
        claimer = NULL;
        return 0;
    case USBDEVFS_GETDRIVER:
        if (!driver[0])
            return ENODATA;
        strcpy(((struct usbdevfs_getdriver *)data->data)->driver, driver);
        return 0;
    case USBDEVFS_IOCTL: { /* detach or attach the kernel's driver */
        struct usbdevfs_ioctl *command = (struct usbdevfs_ioctl *)data->data;
        if (command->ioctl_code == (int)USBDEVFS_DISCONNECT && !driver[0])
            return ENODATA;
        if (command->ioctl_code == (int)USBDEVFS_DISCONNECT) {
            detached++;
            driver[0] = 0;
        } else if (command->ioctl_code == (int)USBDEVFS_CONNECT) {
            attached++;
        }
        return 0;
    }
    case USBDEVFS_CLEAR_HALT:
        cleared++;
        *(*(unsigned int *)data->data & IN_ENDPOINT ? &stopped_in : &stopped_out) = 0;
        move();
        return 0;
    case USBDEVFS_SETCONFIGURATION:
    case USBDEVFS_SETINTERFACE:
    case USBDEVFS_RESET:
        return 0;
    default:
        return ENOTTY;
    }
}

static gboolean handle_ioctl(UMockdevIoctlBase *base, UMockdevIoctlClient *client, gpointer unused)
{
    (void)base, (void)unused;
    pthread_mutex_lock(&lock);
    asked++;
    int error = answer(client);
    pthread_mutex_unlock(&lock);
    eventfd_write(wake, 1);
    umockdev_ioctl_client_complete(client, error ? -1 : 0, error);
    return TRUE;
}

/* A program that ends without a word leaves its transfers to the kernel, which drops them. */
static void client_vanished(UMockdevIoctlBase *base, UMockdevIoctlClient *client, gpointer unused)
{
    (void)base, (void)unused;
    pthread_mutex_lock(&lock);
    forget(client);
    pthread_mutex_unlock(&lock);
}

static int plug(void)
{
    char *text;
    UMockdevIoctlBase *base = umockdev_ioctl_base_new();
    if (present)
        return 1;
    number++;
    snprintf(node, sizeof node, "/dev/bus/usb/001/%03d", number);
    snprintf(path, sizeof path, "/sys/devices/pci0000:00/usb1/1-1");
    if (asprintf(&text,
                 "P: /devices/pci0000:00/usb1/1-1\nN: bus/usb/001/%03d\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
                 "E: DEVNAME=%s\nE: BUSNUM=001\nE: DEVNUM=%03d\nA: busnum=1\\n\nA: devnum=%d\\n\n"
                 "A: bConfigurationValue=1\\n\nA: speed=12\\n\nH: descriptors=%s\n\n",
                 number, node, number, number, descriptors) < 0)
        return 0;
    g_signal_connect(base, "handle-ioctl", G_CALLBACK(handle_ioctl), NULL);
    g_signal_connect(base, "client-vanished", G_CALLBACK(client_vanished), NULL);
    if (!umockdev_testbed_add_from_string(testbed, text, NULL) ||
        !umockdev_testbed_attach_ioctl(testbed, node, base, NULL))
        return 0;
    free(text);
    char *root = umockdev_testbed_get_root_dir(testbed), *file;
    if (asprintf(&file, "%s%s", root, node) < 0)
        return 0;
    int end = posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (end < 0 || unlockpt(end) || unlink(file) || symlink(ptsname(end), file))
        return 0;
    pthread_mutex_lock(&lock);
    master = end;
    terminal = open(file, O_RDWR | O_NOCTTY | O_CLOEXEC);
    present = 1;
    silent = stopped_in = stopped_out = refuse_in = refuse_out = 0;
    show_ready();
    pthread_mutex_unlock(&lock);
    umockdev_testbed_uevent(testbed, path, "add");
    return terminal >= 0;
}

/* As the kernel does it: transfers come back, the descriptor says POLLERR, then the world is told. */
static int unplug(void)
{
    if (!present)
        return 0;
    pthread_mutex_lock(&lock);
    present = 0;
    while (pending.count)
        finish(0, -ESHUTDOWN, 0);
    close(terminal);
    terminal = -1;
    close(master);
    claimer = NULL;
    pthread_mutex_unlock(&lock);
    umockdev_testbed_uevent(testbed, path, "remove");
    umockdev_testbed_remove_device(testbed, path);
    return 1;
}

/* Do one command line; return 0 when it is not understood. */
static int obey(char *line)
{
    int done = 1;
    happened = now_ns();
    if (!strcmp(line, "unplug"))
        return unplug();
    if (!strcmp(line, "plug"))
        return plug();
    pthread_mutex_lock(&lock);
    if (!strcmp(line, "stall in")) {
        stopped_in = refuse_in = 1;
        move();
    } else if (!strcmp(line, "stall out")) {
        stopped_out = refuse_out = 1;
        move();
    } else if (!strcmp(line, "overflow"))
        overflow_next = 1;
    else if (!strcmp(line, "broken"))
        broken_next = 1;
    else if (!strcmp(line, "short"))
        short_writes = 1;
    else if (!strcmp(line, "whole"))
        short_writes = 0;
    else if (!strcmp(line, "silent"))
        silent = 1;
    else if (!strcmp(line, "speak"))
        silent = 0;
    else if (!strcmp(line, "busy"))
        busy = 1;
    else if (!strcmp(line, "free"))
        busy = 0;
    else if (!strncmp(line, "driver ", 7))
        snprintf(driver, sizeof driver, "%.31s", line + 7);
    else if (!strcmp(line, "status"))
        printf("asked %d pending %d claimed %d cleared %d detached %d attached %d\n", asked, pending.count,
               claimer != NULL, cleared, detached, attached);
    else
        done = 0;
    pthread_mutex_unlock(&lock);
    return done;
}

int main(int argc, char **argv)
{
    char line[128];
    int filled = 0;
    device = atoi(argv[1]);
    descriptors = argv[2];
    for (int i = 3; i < argc && string_count < STRINGS; i++, string_count++)
        for (const char *hex = argv[i]; hex[0] && hex[1]; hex += 2)
            sscanf(hex, "%2hhx", &strings[string_count].bytes[strings[string_count].length++]);
    setvbuf(stdout, NULL, _IOLBF, 0);
    wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    testbed = umockdev_testbed_new();
    if (!plug())
        return 1;
    printf("root %s\n", umockdev_testbed_get_root_dir(testbed));
    for (;;) {
        pthread_mutex_lock(&lock);
        int listen = present && !silent && !stopped_in && first(1) >= 0;
        int speak = present && !silent && !stopped_out && first(0) >= 0;
        pthread_mutex_unlock(&lock);
        struct pollfd polled[] = {
            {STDIN_FILENO, POLLIN, 0},
            {wake, POLLIN, 0},
            {listen || speak ? device : -1, (listen ? POLLIN : 0) | (speak ? POLLOUT : 0), 0},
        };
        if (poll(polled, 3, -1) < 0)
            continue;
        eventfd_t count;
        eventfd_read(wake, &count);
        if (polled[2].revents & POLLHUP)
            return 0;
        pthread_mutex_lock(&lock);
        move();
        pthread_mutex_unlock(&lock);
        if (polled[0].revents) {
            if (read(STDIN_FILENO, line + filled, 1) != 1)
                return 0;
            if (line[filled] != '\n') {
                filled += filled < (int)sizeof line - 2;
                continue;
            }
            line[filled] = 0;
            filled = 0;
            int done = obey(line);
            printf(done ? "ok %lld\n" : "error\n", happened);
        }
    }
}
