/* See robot_side.h. */
#include "robot_side.h"

#include <string.h>

static void put(uint8_t *at, uint64_t value, unsigned bytes) {
    for (unsigned k = 0; k < bytes; k++) at[k] = (uint8_t)(value >> (8u * k));
}

static uint64_t get(const uint8_t *at, unsigned bytes) {
    uint64_t value = 0;
    for (unsigned k = 0; k < bytes; k++) value |= (uint64_t)at[k] << (8u * k);
    return value;
}

uint32_t sd_crc32(const uint8_t *data, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t k = 0; k < size; k++) {
        crc ^= data[k];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static void put_floats(uint8_t *at, const float values[6]) {
    for (int k = 0; k < 6; k++) {
        uint32_t bits;
        memcpy(&bits, &values[k], 4);
        put(at + 4 * k, bits, 4);
    }
}

void sd_encode(const sd_packet *packet, uint8_t out[SD_SIZE]) {
    out[0] = 'S', out[1] = 'D', out[2] = 1, out[3] = packet->flags;
    put(out + 4, packet->number, 4);
    put(out + 8, packet->answers, 4);
    put(out + 12, packet->microseconds, 8);
    put_floats(out + 20, packet->values);
    put(out + 44, sd_crc32(out, 44), 4);
}

int sd_decode(const uint8_t *data, size_t size, sd_packet *packet) {
    sd_packet read;
    if (size != SD_SIZE || get(data + 44, 4) != sd_crc32(data, 44)) return 0;
    if (data[0] != 'S' || data[1] != 'D' || data[2] != 1) return 0;
    if (data[3] & 0xE0u) return 0;
    read.flags = data[3];
    read.number = (uint32_t)get(data + 4, 4);
    read.answers = (uint32_t)get(data + 8, 4);
    read.microseconds = get(data + 12, 8);
    for (int k = 0; k < 6; k++) {
        uint32_t bits = (uint32_t)get(data + 20 + 4 * k, 4);
        if ((bits & 0x7F800000u) == 0x7F800000u) return 0; /* infinite, or not a number */
        memcpy(&read.values[k], &bits, 4);
    }
    *packet = read;
    return 1;
}

size_t sd_to_frame(const uint8_t *data, size_t size, uint8_t *out) {
    size_t code = 0, used = 1;
    for (size_t k = 0; k < size; k++) {
        if (data[k]) { out[used++] = data[k]; continue; }
        out[code] = (uint8_t)(used - code);
        code = used++;
    }
    out[code] = (uint8_t)(used - code);
    out[used++] = 0;
    return used;
}

size_t sd_from_frame(const uint8_t *frame, size_t size, uint8_t out[SD_FRAME]) {
    size_t used = 0, at = 0;
    if (size >= SD_FRAME) return 0;
    while (at < size) {
        size_t code = frame[at];
        if (code == 0 || at + code > size) return 0;
        for (size_t k = 1; k < code; k++) out[used++] = frame[at + k];
        at += code;
        if (at < size) out[used++] = 0;
    }
    return used;
}

int sd_take(sd_side *side, const sd_packet *packet, uint64_t now_us) {
    int quiet = !side->heard || now_us - side->heard_us > SD_QUIET_AFTER, active = (packet->flags & SD_ACTIVE) != 0;
    uint32_t ahead = packet->number - side->last;
    uint8_t kind = (packet->flags >> 2) & 3u, pose = kind == SD_POSE;
    if ((packet->flags & SD_READING) || (active && (pose ? !side->poses : kind != side->takes))) return 0;
    if (!quiet && (ahead == 0 || ahead >= 0x80000000u)) return 0;
    for (int k = 0; k < 6; k++)
        if (active && !pose && !(packet->values[k] >= side->low[k] && packet->values[k] <= side->high[k])) return 0;
    side->heard = 1, side->heard_us = now_us, side->last = packet->number, side->following = (uint8_t)active;
    if (active) side->active_us = now_us, side->kind = kind, memcpy(side->values, packet->values, sizeof side->values);
    return 1;
}

int sd_holds(const sd_side *side, uint64_t now_us) {
    return !side->following || now_us - side->active_us > SD_HOLD_AFTER;
}

int sd_asked(const sd_side *side, uint64_t now_us) {
    return side->heard && now_us - side->heard_us <= SD_QUIET_AFTER;
}

static void write_reading(sd_side *side, const float angles[6], uint64_t now_us, uint8_t bytes[SD_SIZE]) {
    sd_packet packet;
    packet.flags = (uint8_t)(SD_READING | (side->takes << 2));
    if (side->measured) packet.flags |= SD_MEASURED;
    if (!sd_holds(side, now_us)) packet.flags |= SD_ACTIVE;
    packet.number = ++side->number;
    packet.answers = side->last;
    packet.microseconds = now_us;
    memcpy(packet.values, angles, sizeof packet.values);
    sd_encode(&packet, bytes);
}

size_t sd_reading(sd_side *side, const float angles[6], uint64_t now_us, uint8_t frame[SD_FRAME]) {
    uint8_t bytes[SD_SIZE];
    write_reading(side, angles, now_us, bytes);
    return sd_to_frame(bytes, SD_SIZE, frame);
}

size_t sd_inertial_reading(sd_side *side, const float angles[6], const float imu[6], uint64_t now_us,
                           uint8_t frame[SD_INERTIAL_FRAME]) {
    uint8_t bytes[SD_INERTIAL_SIZE];
    write_reading(side, angles, now_us, bytes);
    bytes[2] = 2;
    put_floats(bytes + 44, imu);
    put(bytes + 68, sd_crc32(bytes, 68), 4);
    return sd_to_frame(bytes, SD_INERTIAL_SIZE, frame);
}
