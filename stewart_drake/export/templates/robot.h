/* The robot of the scenario @SCENARIO@ with its motors, printed by stewart-drake @VERSION@. */
#ifndef @UPPER@_H
#define @UPPER@_H

struct @NAME@_robot {
    double memory[@NUMBERS@];
};

/* The robot at the start of the scenario. */
void @NAME@_init(struct @NAME@_robot *robot);

/* A step of @PERIOD@ s: command (6,) [@UNIT@], wrench (6,) [N m, N] about P in B, measured (24,) out: pose [rad, m], its
   rate, angles of the cranks [rad], their rates. 0, or which part failed. */
int @NAME@_step(struct @NAME@_robot *robot, const double *command, const double *wrench, double *measured);

/* Why the last step failed, and the leg (0 to 5) to blame or -1; an empty text where it did not. */
const char *@NAME@_why(const struct @NAME@_robot *robot, int *leg);

const double *@NAME@_signal(const struct @NAME@_robot *robot, int k);

#endif
