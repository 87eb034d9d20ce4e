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

const double *@NAME@_signal(const struct @NAME@_robot *robot, int k);

#endif
