/* What the sketches call of Arduino, for a compiler alone. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

struct Line {
  void begin(unsigned long);
  void setTimeout(unsigned long);
  int read();
  size_t readBytes(uint8_t *, size_t);
  size_t write(const uint8_t *, size_t);
  size_t write(uint8_t);
  void flush();
};
extern Line Serial, Serial1;
unsigned long micros();
