// The hardware PWM of an RP2040 or RP2350, with the Arduino core arduino-pico. Legs 0 to 5 are GPIO 2 to 7; serial over USB.
#include <hardware/clocks.h>
#include <hardware/gpio.h>
#include <hardware/pwm.h>

#include "hexapod.h"

static const unsigned FIRST = 2;

void board_begin(uint32_t baud, uint32_t period_us) {
  Serial.begin(baud);
  for (unsigned pin = FIRST; pin < FIRST + 6; pin++) {
    const unsigned slice = pwm_gpio_to_slice_num(pin);
    gpio_set_function(pin, GPIO_FUNC_PWM);
    pwm_set_clkdiv(slice, clock_get_hz(clk_sys) / 1e6f);  // a count is 1 us
    pwm_set_wrap(slice, period_us - 1);
    pwm_set_enabled(slice, true);
  }
}
uint32_t board_micros(void) { return micros(); }
int board_getc(void) { return Serial.read(); }
void board_write(const uint8_t *bytes, unsigned size) { Serial.write(bytes, size); }
void board_servos(const uint16_t commands[6]) {
  for (unsigned k = 0; k < 6; k++) {
    pwm_set_gpio_level(FIRST + k, commands[k]);
  }
}
int board_positions(uint16_t *) { return -1; }
void setup() { hexapod_begin(); }
void loop() { hexapod_poll(); }
