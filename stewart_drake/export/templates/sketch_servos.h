/* The servos of @SCENARIO@, by stewart-drake @VERSION@; board @BOARD@. Change the numbers in the YAML, and export again.

   command = SERVOS_MIDDLE + servos_per_rad (angle - servos_zero), in @MEANS@ */
#ifndef SERVOS_H
#define SERVOS_H

#include <stdint.h>

#ifdef __AVR__
#define SERVOS_POSES 0 /* there is no room for pose.c */
#else
#define SERVOS_POSES @POSES@ /* whether packets may have poses */
#endif
#define SERVOS_BAUD 1000000ul /* of the line to the computer; `serial:DEVICE:BAUD` for another */
#define SERVOS_PROTOCOL @PROTOCOL@ /* of bus servos: 1 Feetech STS, 2 Dynamixel 2.0 */
#define SERVOS_PERIOD_US @PERIOD@ul
#define SERVOS_REST_US @REST@ul /* of silence until the cranks move home; 0 for never */
#define SERVOS_SLOW 0.5 /* [rad/s] of the fastest crank to the first command, and home */
#define SERVOS_FASTEST @FASTEST@ /* [rad/s] */
#define SERVOS_MIDDLE @MIDDLE@

/* A crank's angle is servos_gain times the angle of a packet, plus servos_zero_at. */
static const double servos_gain[6] = {@GAIN@};
static const double servos_zero_at[6] = {@ZERO_AT@}; /* [rad] */
static const double servos_zero[6] = {@ZERO@}; /* [rad] */
static const double servos_per_rad[6] = {@PER_RAD@};
static const double servos_home[6] = {@HOME@}; /* [rad] */
static const double servos_low[6] = {@LOW@}; /* [rad] */
static const double servos_high[6] = {@HIGH@}; /* [rad] */
static const uint16_t servos_least[6] = {@LEAST@};
static const uint16_t servos_most[6] = {@MOST@};

#endif
