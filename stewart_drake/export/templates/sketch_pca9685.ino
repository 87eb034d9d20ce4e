// A PCA9685 on I2C, for any Arduino board: ESP32, Uno, Nano, Teensy, Pico. Legs 0 to 5 are channels 0 to 5.
#include <Wire.h>
#include "hexapod.h"
#include "servos.h"

static const uint8_t ADDRESS = 0x40;
static const float CLOCK = 25.0f;  // [MHz] It is off by some per cent, and all pulses with it: measure one, and correct this.
static float counts_per_us;  // 0.205 at 50 Hz; at a stop counts are rounded inwards
static void put(uint8_t place, const uint8_t *bytes, size_t size) {
  Wire.beginTransmission(ADDRESS);
  Wire.write(place);
  Wire.write(bytes, size);
  Wire.endTransmission();
}

void board_begin(uint32_t baud, uint32_t period_us) {
  const uint8_t prescale = (uint8_t)(CLOCK * period_us / 4096.0f + 0.5f) - 1, asleep = 0x10, awake = 0x20;
  Serial.begin(baud);
  Wire.begin();
  Wire.setClock(400000);
  put(0x00, &asleep, 1);  // where the prescaler can be set
  put(0xFE, &prescale, 1);
  put(0x00, &awake, 1);  // each byte goes to the next place
  counts_per_us = CLOCK / (prescale + 1);
}
uint32_t board_micros(void) { return micros(); }
int board_getc(void) { return Serial.read(); }
void board_write(const uint8_t *bytes, unsigned size) { Serial.write(bytes, size); }
void board_servos(const uint16_t commands[6]) {
  uint8_t bytes[24] = {0};
  for (int k = 0; k < 6; k++) {
    const float least = ceilf(servos_least[k] * counts_per_us), most = floorf(servos_most[k] * counts_per_us);
    const uint16_t off = (uint16_t)fmaxf(least, fminf(most, floorf(commands[k] * counts_per_us + 0.5f)));
    bytes[4 * k + 2] = (uint8_t)off, bytes[4 * k + 3] = (uint8_t)(off >> 8);
  }
  put(0x06, bytes, 24);
}
int board_positions(uint16_t *) { return -1; }
void setup() { hexapod_begin(); }
void loop() { hexapod_poll(); }
