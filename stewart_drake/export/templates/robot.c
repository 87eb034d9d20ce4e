/* The robot of the scenario @SCENARIO@ with its motors, printed by stewart-drake @VERSION@: the closed form of its mechanism. */
#include "@NAME@.h"

#include <math.h>
#include <stdbool.h>

@LOOP@

void @NAME@_init(struct @NAME@_robot *robot)
{
    *(struct loop *)robot = initial;
}

int @NAME@_step(struct @NAME@_robot *robot, const double *command, const double *wrench, double *measured)
{
    struct loop *loop = (struct loop *)robot;
    for (int k = 0; k < 6; k++) {
        loop->command[k] = command[k];
        loop->wrench[k] = wrench[k];
    }
    loop->time[0] = loop->steps * @GRID@;
    loop->failure[0] = 0.0;
    int status = run_parts(loop);
    if (status == 0) {
        status = end_parts(loop);
    }
    for (int k = 0; k < 6; k++) {
        measured[k] = loop->plant.pose[k];
        measured[6 + k] = loop->plant.pose_rate[k];
        measured[12 + k] = loop->crank_state[k] = loop->plant.angles[k];
        measured[18 + k] = loop->crank_state[6 + k] = loop->plant.crank_rate[k];
    }
    loop->steps += 1.0;
    return status;
}

const char *@NAME@_why(const struct @NAME@_robot *robot, int *leg)
{
    static const char *const reasons[] = {"", @REASONS@};
    const struct loop *loop = (const struct loop *)robot;
    *leg = (int)loop->failure[1];
    return reasons[(int)loop->failure[0]];
}

/* A signal that a part computes, by its number: for a debugger. */
const double *@NAME@_signal(const struct @NAME@_robot *robot, int k)
{
    return k < (int)(sizeof signals / sizeof signals[0]) ? signal_at((const struct loop *)robot, k) : 0;
}

typedef char has_room[sizeof(struct loop) == sizeof(struct @NAME@_robot) ? 1 : -1];
