/* The controller @SCENARIO@ on a microcontroller: readings come and commands go as the packets of docs/wire.md. C99, nothing but
   memcpy, no allocation; yours are the line, a clock and the motors' brakes.

   Over UDP, for each datagram of 48 or 72 bytes:  if (board_answer(datagram, size, now_us, answer)) send answer;
   Over a serial line, for each frame to its zero: n = board_from_frame(frame, length, packet);
                                                   if (board_answer(packet, n, now_us, answer)) {
                                                       n = board_to_frame(answer, frame); send n bytes; }
   Every 0.1 s without a reading:                  board_ask(now_us, answer); send answer.

   A reading of 72 bytes has six numbers of an inertial sensor. A controller that knows one works without them as well. */
#include "@NAME@.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SIZE = 48, LARGEST = 72, FRAME = LARGEST + 2, READING = 1, ACTIVE = 2, MEASURED = 16, TAKES = @TAKES@ << 2 };
enum { NEEDS = @NEEDS@ }; /* of a reading: measured angles, where the controller has feedback */@MACHINE@

static struct @NAME@_controller controller;
static long steps = -1;       /* done; before the first reading the controller begins anew */
static uint32_t number, last; /* of our packets, and of the newest reading */

static uint32_t crc32(const uint8_t *data, unsigned size)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (unsigned k = 0; k < size; k++) {
        crc ^= data[k];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

static void put(uint8_t *at, uint64_t value, unsigned bytes)
{
    for (unsigned k = 0; k < bytes; k++) {
        at[k] = (uint8_t)(value >> (8u * k));
    }
}

static uint32_t get(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static float get_float(const uint8_t *at)
{
    const uint32_t bits = get(at);
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

static void write_packet(int flags, const double *values, uint64_t now_us, uint8_t *out)
{
    out[0] = 'S';
    out[1] = 'D';
    out[2] = 1;
    out[3] = (uint8_t)flags;
    put(out + 4, ++number, 4);
    put(out + 8, last, 4);
    put(out + 12, now_us, 8);
    for (int k = 0; k < 6; k++) {
        const float value = (float)values[k];
        uint32_t bits;
        memcpy(&bits, &value, 4);
        put(out + 20 + 4 * k, bits, 4);
    }
    put(out + 44, crc32(out, 44), 4);
}

/* A packet that asks for readings, and moves nothing; the controller begins anew. */
void board_ask(uint64_t now_us, uint8_t *out)
{
    static const double nothing[6] = {0.0};
    steps = -1;
    write_packet(TAKES, nothing, now_us, out);
}

/* Answers a reading with a command; 0 for what is no new reading. A controller that has given up answers with a packet
   that is not active: the robot holds. */
int board_answer(const uint8_t *data, unsigned size, uint64_t now_us, uint8_t *out)
{
    double reading[@UPPER@_READING], reference[@UPPER@_REFERENCE], command[6] = {0.0};
    if ((size != SIZE && size != LARGEST) || data[0] != 'S' || data[1] != 'D' || data[2] != (size == SIZE ? 1 : 2)
        || get(data + size - 4) != crc32(data, size - 4)) {
        return 0;
    }
    if ((data[3] & 0xE0) || (data[3] & 0xC) != TAKES || (data[3] & NEEDS) != NEEDS) {
        return 0;
    }
    const uint32_t ahead = get(data + 4) - last;
    if (steps >= 0 && (ahead == 0 || ahead >= 0x80000000u)) {
        return 0;
    }
    for (int k = 0; k < 6; k++) {
        const float value = get_float(data + 20 + 4 * k);
        if (!(value > -12.57f && value < 12.57f)) {
            return 0;
        }
        reading[k] = @ANGLE@;
    }
    for (int k = 6; k < @UPPER@_READING; k++) {
        reading[k] = size == SIZE ? NAN : (double)get_float(data + 20 + 4 * k);
    }
    if (steps < 0) {
        @NAME@_init(&controller);
        steps = 0;
    }
    last = get(data + 4);
    @NAME@_reference(steps++, reference);
    const int status = @NAME@_step(&controller, reading, reference, 0.0, command);@ANGLES@
    write_packet(status == 0 ? ACTIVE | TAKES : TAKES, command, now_us, out);
    return 1;
}

/* COBS, for a serial line: the packet as a frame with its zero; how many bytes it has. */
unsigned board_to_frame(const uint8_t *packet, uint8_t *frame)
{
    unsigned code = 0, used = 1;
    for (unsigned k = 0; k < SIZE; k++) {
        if (packet[k]) {
            frame[used++] = packet[k];
            continue;
        }
        frame[code] = (uint8_t)(used - code);
        code = used++;
    }
    frame[code] = (uint8_t)(used - code);
    frame[used++] = 0;
    return used;
}

/* A frame without its last zero as a packet (FRAME,); how many bytes it has, 0 where it is none. */
unsigned board_from_frame(const uint8_t *frame, unsigned size, uint8_t *packet)
{
    unsigned used = 0, at = 0;
    if (size >= FRAME) {
        return 0;
    }
    while (at < size) {
        const unsigned code = frame[at];
        if (code == 0 || at + code > size) {
            return 0;
        }
        for (unsigned k = 1; k < code; k++) {
            packet[used++] = frame[at + k];
        }
        at += code;
        if (at < size) {
            packet[used++] = 0;
        }
    }
    return used;
}
