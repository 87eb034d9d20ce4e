/* Replays rows of reading, reference, age and command (numbers between commas) from standard input, and prints how far the
   commands are from those in the rows: `./replay < replay.csv`. With -p it prints its commands too. */
#include "@NAME@.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { GIVEN = @UPPER@_READING + @UPPER@_REFERENCE + 1, COLUMNS = GIVEN + 6 };

static struct @NAME@_controller controller;

static int read_row(double *row)
{
    for (int k = 0; k < COLUMNS; k++) {
        if (scanf(k == 0 ? " %lf" : " ,%lf", &row[k]) != 1) {
            return 0;
        }
    }
    return 1;
}

int main(int count, char **arguments)
{
    const int prints = count > 1 && arguments[1][0] == '-' && arguments[1][1] == 'p';
    double row[COLUMNS], command[6], largest = 0.0, scale = 0.0;
    long rows = 0;
    @NAME@_init(&controller);
    for (; read_row(row); rows++) {
        const double *reference = &row[@UPPER@_READING];
        const int status = @NAME@_step(&controller, row, reference, row[GIVEN - 1], command);
        if (status != 0) {
            int leg = -1;
            const char *reason = @NAME@_why(&controller, &leg);
            fprintf(stderr, "step %ld: %s: %s", rows, status < 0 ? "command" : @NAME@_parts[status - 1],
                status < 0 ? "not_finite" : reason);
            fprintf(stderr, leg < 0 ? "\n" : ", leg %d\n", leg);
            return EXIT_FAILURE;
        }
        for (int k = 0; k < 6; k++) {
            largest = fmax(largest, fabs(command[k] - row[GIVEN + k]));
            scale = fmax(scale, fabs(row[GIVEN + k]));
            if (prints) {
                printf(k < 5 ? "%.17g," : "%.17g\n", command[k]);
            }
        }
    }
    fprintf(stderr, "%ld steps, largest difference of a command %.3g of %.3g @UNIT@\n", rows, largest, scale);
    return largest <= 1e-12 * scale ? EXIT_SUCCESS : EXIT_FAILURE;
}
