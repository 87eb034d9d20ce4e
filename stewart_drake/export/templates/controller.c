/* The controller of the scenario @SCENARIO@, printed by stewart-drake @VERSION@ from the laws that run there. */
#include "@NAME@.h"

#include <math.h>
#include <stdbool.h>

@LOOP@

void @NAME@_init(struct @NAME@_controller *controller)
{
    *(struct loop *)controller = initial;
}

void @NAME@_reset(struct @NAME@_controller *controller)
{
    @NAME@_init(controller);
}

const char *const @NAME@_parts[] = {@PARTS@};

int @NAME@_step(
    struct @NAME@_controller *controller, const double *reading, const double *reference, double age, double *command)
{
    struct loop *loop = (struct loop *)controller;
    const double *given = @COMMAND@;
    for (int k = 0; k < @BOUND@; k++) {
        loop->@READS@[k] = reading[k];
    }@INERTIAL@
@GIVEN@
    loop->time[0] = loop->steps * @GRID@;
    loop->age[0] = age / @TICK@;
    loop->failure[0] = 0.0;
    int status = run_parts(loop);
    if (status != 0) {
        return status;
    }
    for (int k = 0; k < 6; k++) {
        if (!isfinite(given[k])) {
            return -1;
        }
    }
    for (int k = 0; k < 6; k++) {
        command[k] = minimum(maximum(given[k], -@LIMIT@[k]), @LIMIT@[k]);
    }
    status = end_parts(loop);
    loop->steps += 1.0;
    return status;
}

const char *@NAME@_why(const struct @NAME@_controller *controller, int *leg)
{
    static const char *const reasons[] = {"", @REASONS@};
    const struct loop *loop = (const struct loop *)controller;
    *leg = (int)loop->failure[1];
    return reasons[(int)loop->failure[0]];
}

const double *@NAME@_signal(const struct @NAME@_controller *controller, const char *name, int *size)
{
    for (int k = 0; k < (int)(sizeof signals / sizeof signals[0]); k++) {
        int n = 0;
        while (name[n] != '\0' && name[n] == signals[k].name[n]) {
            n++;
        }
        if (name[n] == signals[k].name[n]) {
            *size = signals[k].size;
            return signal_at((const struct loop *)controller, k);
        }
    }
    return 0;
}

/* The record fits into what the header has for it. */
typedef char has_room[sizeof(struct loop) == sizeof(struct @NAME@_controller) ? 1 : -1];
