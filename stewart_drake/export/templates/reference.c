/* The reference of the scenario @SCENARIO@ at each step of its controller. */
#include "@NAME@.h"

static const double table[@UPPER@_ROWS][@UPPER@_REFERENCE] = {
@TABLE@
};

void @NAME@_reference(long step, double *reference)
{
    const long row = step < @UPPER@_ROWS ? step : @UPPER@_ROWS - 1;
    for (int k = 0; k < @UPPER@_REFERENCE; k++) {
        reference[k] = table[row][k];
    }
}
