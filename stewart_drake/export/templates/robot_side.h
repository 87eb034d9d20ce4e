/* The robot's side of docs/wire.md for a microcontroller: C99, nothing but memcpy of the C library, no memory of its own.

   In each tick of your loop:
     for every whole frame from the line:  n = sd_from_frame(frame, length, bytes);
                                           if (sd_decode(bytes, n, &packet)) sd_take(&side, &packet, now_us);
     if (sd_holds(&side, now_us))          hold: keep the last angle, or brake;    else follow side.values;
     if (sd_asked(&side, now_us))          sd_reading(&side, angles, now_us, frame), and send what it returns;
                                           with an inertial sensor on the platform sd_inertial_reading. */
#ifndef ROBOT_SIDE_H
#define ROBOT_SIDE_H

#include <stddef.h>
#include <stdint.h>

#define SD_SIZE 48u               /* bytes of a packet */
#define SD_FRAME (SD_SIZE + 2u)   /* bytes of a frame, with its zero */
#define SD_INERTIAL_SIZE 72u      /* bytes of a reading with an inertial sensor, version 2 */
#define SD_INERTIAL_FRAME (SD_INERTIAL_SIZE + 2u)
#define SD_READING 1u
#define SD_ACTIVE 2u
#define SD_MEASURED 16u
#define SD_POSE 3u                /* kind of a command: 0 angle [rad], 1 torque [N m], 2 current [A], 3 pose [rad, m] */
#define SD_HOLD_AFTER 100000u     /* us */
#define SD_QUIET_AFTER 1000000u   /* us */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint8_t flags;
    uint32_t number, answers;
    uint64_t microseconds;
    float values[6];
} sd_packet;

typedef struct {
    uint8_t takes;                /* yours: kind of the motors' commands, 0 to 2 */
    uint8_t poses;                /* yours: 1 where poses are taken too */
    uint8_t measured;             /* yours: 1 where readings are measured; 0 without encoders: they are the last command */
    float low[6], high[6];        /* yours: limits of a command, if it is no pose */
    float values[6];              /* the command to follow */
    uint8_t kind;                 /* its kind */
    uint8_t following, heard;     /* these, and the rest, begin at zero */
    uint32_t last, number;
    uint64_t heard_us, active_us;
} sd_side;

uint32_t sd_crc32(const uint8_t *data, size_t size);

void sd_encode(const sd_packet *packet, uint8_t out[SD_SIZE]);

/* Whether the bytes are a packet; what is none leaves *packet as it was. */
int sd_decode(const uint8_t *data, size_t size, sd_packet *packet);

/* COBS. out has room for size + 2 bytes, size <= 254; returns how many are used. */
size_t sd_to_frame(const uint8_t *data, size_t size, uint8_t *out);

/* A frame of at most SD_FRAME bytes without its last zero; returns how many bytes are in out, 0 where it is none. */
size_t sd_from_frame(const uint8_t *frame, size_t size, uint8_t out[SD_FRAME]);

/* Whether a packet is accepted; an active one is followed from now on, an inactive one says to hold. */
int sd_take(sd_side *side, const sd_packet *packet, uint64_t now_us);

int sd_holds(const sd_side *side, uint64_t now_us);

int sd_asked(const sd_side *side, uint64_t now_us);

/* A frame with six angles [rad]; returns how many of its bytes are to be sent. */
size_t sd_reading(sd_side *side, const float angles[6], uint64_t now_us, uint8_t frame[SD_FRAME]);

/* The same with rates [rad/s] and specific force [m/s^2] along the axes of an inertial sensor; NaN where not new. */
size_t sd_inertial_reading(sd_side *side, const float angles[6], const float imu[6], uint64_t now_us,
                           uint8_t frame[SD_INERTIAL_FRAME]);

#ifdef __cplusplus
}
#endif

#endif
