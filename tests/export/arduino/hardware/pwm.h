unsigned pwm_gpio_to_slice_num(unsigned gpio);
void pwm_set_clkdiv(unsigned slice, float divider);
void pwm_set_wrap(unsigned slice, uint16_t wrap);
void pwm_set_enabled(unsigned slice, bool enabled);
void pwm_set_gpio_level(unsigned gpio, uint16_t level);
