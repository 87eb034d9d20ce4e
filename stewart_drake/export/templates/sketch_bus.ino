// Bus servos on a half-duplex line, with an adapter without echo between Serial1 and the bus; 1,000,000 baud. Legs 0 to 5
// are servos 1 to 6. The servos get their torque with the first command, which is where they are.
#include "hexapod.h"
#include "bus.h"

static uint8_t bytes[BUS_LARGEST];
static bool on;

static void send(unsigned size) {
  Serial1.write(bytes, size);
  Serial1.flush();
}

void board_begin(uint32_t baud, uint32_t) {
  Serial.begin(baud);
  Serial1.begin(1000000);  // ESP32: begin(1000000, SERIAL_8N1, RX_PIN, TX_PIN)
  Serial1.setTimeout(6);   // [ms] for all six answers
}
uint32_t board_micros(void) { return micros(); }
int board_getc(void) { return Serial.read(); }
void board_write(const uint8_t *data, unsigned size) { Serial.write(data, size); }
void board_servos(const uint16_t commands[6]) {
  send(bus_goals(commands, bytes));
  if (!on) {
    send(bus_torque(bytes));
    on = true;
  }
}
int board_positions(uint16_t commands[6]) {
  while (Serial1.read() >= 0) {
  }
  send(bus_ask(bytes));
  return bus_positions(bytes, Serial1.readBytes(bytes, BUS_ANSWERS), commands);
}
void setup() { hexapod_begin(); }
void loop() { hexapod_poll(); }
