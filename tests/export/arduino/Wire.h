struct TwoWire {
  void begin();
  void setClock(uint32_t);
  void beginTransmission(uint8_t);
  size_t write(uint8_t);
  size_t write(const uint8_t *, size_t);
  uint8_t endTransmission();
};
extern TwoWire Wire;
