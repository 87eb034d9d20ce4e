/* The packets of bus servos 1 to 6: Feetech's protocol of the STS series, or Dynamixel's protocol 2.0. */
#ifndef BUS_H
#define BUS_H

#include <stdint.h>

#define BUS_LARGEST 96  /* bytes of the longest packet, and of all answers */
#define BUS_ANSWERS (SERVOS_PROTOCOL == 2 ? 90 : 48) /* bytes of six answers */

#include "servos.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Packets for all servos at once; how many bytes they have. */
unsigned bus_goals(const uint16_t positions[6], uint8_t *out);
unsigned bus_torque(uint8_t *out);
unsigned bus_ask(uint8_t *out);

/* The positions in the answers to bus_ask; 1 if all six servos have answered, whole and without an error, else 0. */
int bus_positions(const uint8_t *bytes, unsigned size, uint16_t positions[6]);

#ifdef __cplusplus
}
#endif

#endif
