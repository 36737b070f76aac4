#include "usb_descriptors.h"

#include <stddef.h>
#include <string.h>

#include "protocol.h"
#include "usb_endpoint.h"

#define RELEASE 0x0100u

enum kind {
    DEVICE = 1,
    CONFIGURATION = 2,
    STRING = 3,
    INTERFACE = 4,
    ENDPOINT = 5,
    INTERFACE_ASSOCIATION = 11,
    BINARY_OBJECT_STORE = 15,
    CAPABILITY = 16,
    CLASS_INTERFACE = 0x24,
};
enum text { TEXT_LANGUAGES, TEXT_MAKER, TEXT_NAME, TEXT_SERIAL, TEXT_RIG, TEXT_PORT };

#define U16(value) (uint8_t)((value) & 0xFFu), (uint8_t)((value) >> 8 & 0xFFu)
#define U32(value) U16((value) & 0xFFFFu), U16((uint32_t)(value) >> 16)

static const uint8_t device[] = {
    18, DEVICE, U16(0x0210u),                             /* 2.1: has a binary object store */
    0xEF, 2, 1,                                           /* interfaces are grouped by associations */
    USB_PACKET, U16(HR_USB_VENDOR), U16(HR_USB_PRODUCT), U16(RELEASE), /**/
    TEXT_MAKER, TEXT_NAME, TEXT_SERIAL, 1,
};

#define INTERFACE_OF(number, endpoints, type, subtype, protocol, text)                                      \
    9, INTERFACE, number, 0, endpoints, type, subtype, protocol, text
#define ENDPOINT_OF(address, type, packet, interval) 7, ENDPOINT, address, type, U16(packet), interval
#define CONFIGURATION_BYTES (9u + 9u + 14u + 8u + 9u + 5u + 5u + 4u + 5u + 7u + 9u + 14u)

static const uint8_t configuration[] = {
    /* Bus powered, 100 mA: a Pico takes a third of it. */
    9, CONFIGURATION, U16(CONFIGURATION_BYTES), USB_INTERFACES, USB_CONFIGURATION, 0, 0x80, 50,
    /* The rig: vendor class. */
    INTERFACE_OF(USB_INTERFACE_RIG, 2, 0xFF, 0, 0, TEXT_RIG),
    ENDPOINT_OF(0x80 | USB_PIPE_RIG, USB_BULK, USB_PACKET, 0),
    ENDPOINT_OF(USB_PIPE_RIG, USB_BULK, USB_PACKET, 0),
    /* The serial port: CDC, abstract control model, no AT commands. */
    8, INTERFACE_ASSOCIATION, USB_INTERFACE_SERIAL, 2, 2, 2, 0, TEXT_PORT,
    INTERFACE_OF(USB_INTERFACE_SERIAL, 1, 2, 2, 0, TEXT_PORT),
    5, CLASS_INTERFACE, 0, U16(0x0110u),                                   /* header: CDC 1.10 */
    5, CLASS_INTERFACE, 1, 0, USB_INTERFACE_SERIAL_DATA,                   /* no call management */
    4, CLASS_INTERFACE, 2, 2,                                              /* line coding and control line state */
    5, CLASS_INTERFACE, 6, USB_INTERFACE_SERIAL, USB_INTERFACE_SERIAL_DATA, /* union */
    ENDPOINT_OF(0x80 | USB_PIPE_SERIAL_NOTES, USB_PERIODIC, 16, 255),      /* sends no notification */
    INTERFACE_OF(USB_INTERFACE_SERIAL_DATA, 2, 10, 0, 0, 0),
    ENDPOINT_OF(0x80 | USB_PIPE_SERIAL, USB_BULK, USB_PACKET, 0),
    ENDPOINT_OF(USB_PIPE_SERIAL, USB_BULK, USB_PACKET, 0),
};

/* Microsoft OS 2.0 descriptors (specification of 2018, tables 10 to 15): WinUSB for the vendor interface, and the GUID
 * by which libusb finds it. Windows reads them once for each vendor, product and release. */
#define WINDOWS_8_1 0x06030000u
#define W(letter) letter, 0
#define FEATURES_BYTES (20u + 132u)
#define FUNCTION_BYTES (8u + FEATURES_BYTES)
#define SUBSET_BYTES (8u + FUNCTION_BYTES)
#define SET_BYTES (10u + SUBSET_BYTES)

static const uint8_t microsoft[] = {
    U16(10), U16(0), U32(WINDOWS_8_1), U16(SET_BYTES),             /* set */
    U16(8), U16(1), 0, 0, U16(SUBSET_BYTES),                       /* of the first configuration */
    U16(8), U16(2), USB_INTERFACE_RIG, 0, U16(FUNCTION_BYTES),     /* of the function that begins there */
    U16(20), U16(3), 'W', 'I', 'N', 'U', 'S', 'B', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, /* compatible id */
    U16(132), U16(4), U16(7), U16(42),                             /* registry property of several strings */
    W('D'), W('e'), W('v'), W('i'), W('c'), W('e'), W('I'), W('n'), W('t'), W('e'), W('r'), W('f'), W('a'), W('c'),
    W('e'), W('G'), W('U'), W('I'), W('D'), W('s'), W(0), U16(80), /**/
    W('{'), W('2'), W('8'), W('f'), W('4'), W('1'), W('e'), W('8'), W('5'), W('-'), W('a'), W('6'), W('9'), W('6'),
    W('-'), W('4'), W('a'), W('d'), W('a'), W('-'), W('b'), W('e'), W('d'), W('0'), W('-'), W('1'), W('d'), W('4'),
    W('5'), W('7'), W('6'), W('2'), W('e'), W('d'), W('b'), W('1'), W('e'), W('}'), W(0), W(0), /**/
};

static const uint8_t object_store[] = {
    5, BINARY_OBJECT_STORE, U16(5u + 7u + 28u), 2,    /**/
    7, CAPABILITY, 2, U32(0),                         /* USB 2.0 extension: no link power management */
    28, CAPABILITY, 5, 0,                             /* platform: {D8DD60DF-4589-4CC7-9CD2-659D9E648A9F} */
    0xDF, 0x60, 0xDD, 0xD8, 0x89, 0x45, 0xC7, 0x4C, 0x9C, 0xD2, 0x65, 0x9D, 0x9E, 0x64, 0x8A, 0x9F,
    U32(WINDOWS_8_1), U16(SET_BYTES), USB_MICROSOFT_REQUEST, 0,
};

/* The sizes that the tables state of themselves. */
typedef char sizes_are_right[sizeof configuration == CONFIGURATION_BYTES && sizeof microsoft == SET_BYTES &&
                                     sizeof device == 18u && sizeof object_store == 40u
                                 ? 1
                                 : -1];

static const char *const texts[] = {
    [TEXT_MAKER] = "haptic-rig",
    [TEXT_NAME] = "haptic rig on RP2040",
    [TEXT_RIG] = "haptic rig bytes",
    [TEXT_PORT] = "haptic rig bytes, a serial port", /* 31 letters: a whole packet, which an empty one ends */
};
#define TEXTS (sizeof texts / sizeof *texts)
#define SERIAL_DIGITS 16u
#define ENGLISH 0x0409u

static uint8_t letter_of(uint8_t index, uint64_t serial, size_t at)
{
    if (index != TEXT_SERIAL)
        return (uint8_t)texts[index][at];
    return (uint8_t) "0123456789ABCDEF"[serial >> 4u * (SERIAL_DIGITS - 1u - at) & 15u];
}

static struct usb_text string(uint8_t index, uint64_t serial, uint8_t *room)
{
    struct usb_text text = {.bytes = NULL, .count = 0};
    if (index >= TEXTS)
        return text;
    size_t letters = 1;
    if (index == TEXT_LANGUAGES) {
        room[2] = ENGLISH & 0xFFu;
        room[3] = ENGLISH >> 8;
    } else {
        letters = index == TEXT_SERIAL ? SERIAL_DIGITS : strlen(texts[index]);
        for (size_t i = 0; i < letters; i++) {
            room[2u + 2u * i] = letter_of(index, serial, i);
            room[3u + 2u * i] = 0;
        }
    }
    text.count = (uint16_t)(2u + 2u * letters);
    room[0] = (uint8_t)text.count;
    room[1] = STRING;
    text.bytes = room;
    return text;
}

struct usb_text usb_descriptor(uint8_t kind, uint8_t index, uint64_t serial, uint8_t *room)
{
    const struct usb_text none = {.bytes = NULL, .count = 0};
    if (kind == STRING)
        return string(index, serial, room);
    if (index != 0)
        return none;
    if (kind == DEVICE)
        return (struct usb_text){device, sizeof device};
    if (kind == CONFIGURATION)
        return (struct usb_text){configuration, sizeof configuration};
    if (kind == BINARY_OBJECT_STORE)
        return (struct usb_text){object_store, sizeof object_store};
    return none;
}

struct usb_text usb_microsoft_descriptor(void)
{
    return (struct usb_text){microsoft, sizeof microsoft};
}
