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
double sin(double), cos(double), asin(double), acos(double), atan2(double, double), tanh(double), exp(double);
double log10(double), pow(double, double), fmod(double, double);
#endif
