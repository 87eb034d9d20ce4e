/* A board for tests: the clock, what arrives, and where the servos are is set from outside. */
#include "hexapod.h"

#include <string.h>

uint32_t fake_clock;
uint16_t fake_commands[6], fake_positions[6];
int fake_told = -1;
uint8_t fake_in[512], fake_out[512];
unsigned fake_arrived, fake_read, fake_sent, fake_ticks;

void board_begin(uint32_t baud, uint32_t period_us)
{
    fake_ticks = baud == 1000000 && period_us > 0 ? 0 : 1000000;
}
uint32_t board_micros(void)
{
    return fake_clock;
}
int board_getc(void)
{
    return fake_read < fake_arrived ? fake_in[fake_read++] : -1;
}
void board_write(const uint8_t *bytes, unsigned size)
{
    memcpy(fake_out, bytes, fake_sent = size);
}
void board_servos(const uint16_t commands[6])
{
    memcpy(fake_commands, commands, sizeof fake_commands);
    fake_ticks++;
}
int board_positions(uint16_t commands[6])
{
    memcpy(commands, fake_positions, sizeof fake_positions);
    return fake_told;
}
