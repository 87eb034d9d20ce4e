/* See bus.h. Addresses: Feetech's memory table of the STS3215; ROBOTIS e-Manual, control table of the XL330-M288-T. */
#include "bus.h"

#if SERVOS_PROTOCOL == 2
enum { TORQUE = 64, GOAL = 116, PRESENT = 132, WIDTH = 4, DATA = 9, ANSWER = 15 };

static unsigned check(const uint8_t *bytes, unsigned size)
{
    unsigned crc = 0;
    for (unsigned k = 0; k < size; k++) {
        crc ^= (unsigned)bytes[k] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u ? (crc << 1) ^ 0x8005u : crc << 1) & 0xFFFFu;
        }
    }
    return crc;
}

static int is_answer(const uint8_t *b)
{
    const unsigned crc = check(b, ANSWER - 2);
    return b[0] == 0xFF && b[1] == 0xFF && b[2] == 0xFD && b[5] == 8 && b[6] == 0 && b[7] == 0x55 && !(b[8] & 0x7F)
        && b[13] == (crc & 0xFF) && b[14] == crc >> 8;
}
#else
enum { TORQUE = 40, GOAL = 42, PRESENT = 56, WIDTH = 2, DATA = 5, ANSWER = 8 };

static unsigned check(const uint8_t *bytes, unsigned size)
{
    unsigned sum = 0;
    for (unsigned k = 2; k < size; k++) {
        sum += bytes[k];
    }
    return ~sum & 0xFFu;
}

/* Error bits of the status do not spoil a position. */
static int is_answer(const uint8_t *b)
{
    return b[0] == 0xFF && b[1] == 0xFF && b[3] == 4 && b[7] == check(b, ANSWER - 1);
}
#endif

/* The start of a packet for all servos: instruction, address and length of the data; its length is completed by `ended`. */
static unsigned begun(uint8_t instruction, unsigned address, unsigned width, uint8_t *out)
{
    unsigned n = 0;
    out[n++] = 0xFF;
    out[n++] = 0xFF;
#if SERVOS_PROTOCOL == 2
    out[n++] = 0xFD;
    out[n++] = 0;
    out[n++] = 0xFE;
    n += 2;
    out[n++] = instruction;
    out[n++] = (uint8_t)address;
    out[n++] = 0;
    out[n++] = (uint8_t)width;
    out[n++] = 0;
#else
    out[n++] = 0xFE;
    n += 1;
    out[n++] = instruction;
    out[n++] = (uint8_t)address;
    out[n++] = (uint8_t)width;
#endif
    return n;
}

static unsigned ended(uint8_t *out, unsigned n)
{
#if SERVOS_PROTOCOL == 2
    out[5] = (uint8_t)(n - 5);
    out[6] = 0;
    const unsigned crc = check(out, n);
    out[n++] = (uint8_t)crc;
    out[n++] = (uint8_t)(crc >> 8);
#else
    out[3] = (uint8_t)(n - 3);
    out[n] = (uint8_t)check(out, n);
    n++;
#endif
    return n;
}

unsigned bus_goals(const uint16_t positions[6], uint8_t *out)
{
    unsigned n = begun(0x83, GOAL, WIDTH, out);
    for (unsigned leg = 0; leg < 6; leg++) {
        out[n++] = (uint8_t)(leg + 1);
        for (unsigned k = 0; k < WIDTH; k++) {
            out[n++] = k < 2 ? (uint8_t)(positions[leg] >> (8 * k)) : 0;
        }
    }
    return ended(out, n);
}

unsigned bus_torque(uint8_t *out)
{
    unsigned n = begun(0x83, TORQUE, 1, out);
    for (unsigned leg = 0; leg < 6; leg++) {
        out[n++] = (uint8_t)(leg + 1);
        out[n++] = 1;
    }
    return ended(out, n);
}

unsigned bus_ask(uint8_t *out)
{
    unsigned n = begun(0x82, PRESENT, WIDTH, out);
    for (unsigned leg = 0; leg < 6; leg++) {
        out[n++] = (uint8_t)(leg + 1);
    }
    return ended(out, n);
}

int bus_positions(const uint8_t *bytes, unsigned size, uint16_t positions[6])
{
    unsigned told = 0;
    for (unsigned at = 0; at + ANSWER <= size; at++) {
        const uint8_t *answer = bytes + at;
        const unsigned id = answer[SERVOS_PROTOCOL == 2 ? 4 : 2];
        if (id >= 1 && id <= 6 && is_answer(answer)) {
            positions[id - 1] = (uint16_t)(answer[DATA] | (unsigned)answer[DATA + 1] << 8);
            told |= 1u << (id - 1);
        }
    }
    return told == 63;
}
