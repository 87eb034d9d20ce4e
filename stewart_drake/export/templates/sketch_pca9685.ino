// A PCA9685 on I2C, for any Arduino board: ESP32, Uno, Nano, Teensy, Pico. Legs 0 to 5 are channels 0 to 5.
// The chip's clock is off by some per cent, and all pulses with it: measure one, and correct CLOCK.
#include <Wire.h>

#include "board.h"

static const uint8_t ADDRESS = 0x40;
static const double CLOCK = 25.0;  // [MHz]
static double counts_per_us;

static void put(uint8_t place, uint8_t value) {
  Wire.beginTransmission(ADDRESS);
  Wire.write(place);
  Wire.write(value);
  Wire.endTransmission();
}

void board_begin(uint32_t baud, uint32_t period_us) {
  const uint8_t prescale = (uint8_t)(CLOCK * period_us / 4096.0 + 0.5);
  Serial.begin(baud);
  Wire.begin();
  Wire.setClock(400000);
  put(0x00, 0x10);  // asleep, where the prescaler can be set
  put(0xFE, prescale - 1);
  put(0x00, 0x20);  // awake, the next byte to the next place
  counts_per_us = CLOCK / prescale;
}
uint32_t board_micros(void) { return micros(); }
int board_getc(void) { return Serial.read(); }
void board_write(const uint8_t *bytes, unsigned size) { Serial.write(bytes, size); }
void board_servos(const uint16_t commands[6]) {
  Wire.beginTransmission(ADDRESS);
  Wire.write(0x06);
  for (int k = 0; k < 6; k++) {
    const uint16_t off = (uint16_t)(commands[k] * counts_per_us + 0.5);
    const uint8_t bytes[4] = {0, 0, (uint8_t)off, (uint8_t)(off >> 8)};
    Wire.write(bytes, 4);
  }
  Wire.endTransmission();
}
int board_positions(uint16_t *) { return -1; }
void setup() { hexapod_begin(); }
void loop() { hexapod_poll(); }
