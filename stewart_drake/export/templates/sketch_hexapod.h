/* What a board has to do for the loop in hexapod.c. A file of some 40 lines; everything else is the same anywhere. */
#ifndef HEXAPOD_H
#define HEXAPOD_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Opens the line to the computer, and what the servos need: one command every period. Moves nothing. */
void board_begin(uint32_t baud, uint32_t period_us);

/* A clock [us] that may begin again after 2^32. */
uint32_t board_micros(void);

/* The next byte from the computer, -1 without one; and bytes to it. */
int board_getc(void);
void board_write(const uint8_t *bytes, unsigned size);

/* Sends the commands of servos 0 to 5: microseconds of a pulse, or counts of a bus servo. */
void board_servos(const uint16_t commands[6]);

/* The commands at which the servos really are: 1 if all six have told, 0 if not this time, -1 for servos that cannot. */
int board_positions(uint16_t commands[6]);

/* In hexapod.c: to be called once, and then again and again. */
void hexapod_begin(void);
void hexapod_poll(void);

/* The command of a servo at an angle of its crank [rad], never outside of its limits, and the angle at a command. */
uint16_t hexapod_command(int leg, double angle);
double hexapod_angle(int leg, uint16_t command);

#ifdef __cplusplus
}
#endif

#endif
