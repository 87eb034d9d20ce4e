/* Python's min: the first unless the second is smaller. */
static double lesser(double a, double b) { return b < a ? b : a; }

/* Python's max: the first unless the second is larger. */
static double greater(double a, double b) { return b > a ? b : a; }

static int lesser_int(int a, int b) { return b < a ? b : a; }

static int greater_int(int a, int b) { return b > a ? b : a; }

/* numpy's: NaN where one is. */
static double minimum(double a, double b) { return isnan(a) || a < b ? a : b; }

/* numpy's: NaN where one is. */
static double maximum(double a, double b) { return isnan(a) || a > b ? a : b; }

static double sign_of(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }

/* By squares, as numba has it. */
static double power(double x, int n)
{
    double result = 1.0;
    for (; n > 0; n >>= 1) {
        if (n & 1) {
            result *= x;
        }
        x *= x;
    }
    return result;
}

/* With the sign of the divisor. */
static double modulo(double a, double b)
{
    const double rest = fmod(a, b);
    return rest != 0.0 && (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}

static void copy_numbers(double *out, const double *values, int count)
{
    for (int k = 0; k < count; k++) {
        out[k] = values[k];
    }
}
