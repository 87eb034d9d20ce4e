/* What the laws need of math.h, for WebAssembly: some are instructions of it, the others are the browser's. */
#ifndef TAB_MATH_H
#define TAB_MATH_H
#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
#define isnan(x) __builtin_isnan(x)
#define isfinite(x) (__builtin_fabs(x) < __builtin_inf())
#define fabs __builtin_fabs
#define sqrt __builtin_sqrt
#define rint __builtin_rint
#define BROWSER(name, ...) __attribute__((import_module("env"), import_name(#name))) double name(__VA_ARGS__)
BROWSER(sin, double); BROWSER(cos, double); BROWSER(asin, double); BROWSER(acos, double); BROWSER(tanh, double);
BROWSER(exp, double); BROWSER(log10, double); BROWSER(atan2, double, double); BROWSER(pow, double, double);
BROWSER(fmod, double, double);
#endif
