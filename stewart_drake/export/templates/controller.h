/* The controller of the scenario @SCENARIO@, printed by stewart-drake @VERSION@. C99; it needs math.h alone, and allocates
   nothing. Do not compile it with -ffast-math: it checks for NaN and infinity. */
#ifndef @UPPER@_H
#define @UPPER@_H

#define @UPPER@_PERIOD @PERIOD@ /* [s] between two steps */
#define @UPPER@_READING @READING@ /* numbers of a reading: @MEANS@ */
#define @UPPER@_REFERENCE @REFERENCE@ /* numbers of a sample of the reference, @SAMPLE@ */
#define @UPPER@_ROWS @ROWS@ /* samples of the scenario's reference in @NAME@_reference.c */

#ifdef __cplusplus
extern "C" {
#endif

/* All signals and states. */
struct @NAME@_controller {
    double memory[@NUMBERS@];
};

/* The state before the first step; `reset` is the same once more. */
void @NAME@_init(struct @NAME@_controller *controller);
void @NAME@_reset(struct @NAME@_controller *controller);

/* One step.

   reading: @MEANS@.
   reference: (@REFERENCE@,) @MEANING@.
   age: [s] of the reading, beyond that in the scenario.
   command: (6,) out, for the motors [@UNIT@].

   Returns 0. With any other number the controller has given up: `command` is not set, and the motors are to be
   brought to rest. 1 and more count the parts of @NAME@_parts; -1 is a command that is not finite. */
int @NAME@_step(
    struct @NAME@_controller *controller, const double *reading, const double *reference, double age, double *command);

/* Names of the parts, in their order. */
extern const char *const @NAME@_parts[];

/* Why the last step failed, such as `unreachable_pose`, and the leg (0 to 5) to blame or -1; else an empty text. */
const char *@NAME@_why(const struct @NAME@_controller *controller, int *leg);

/* A signal of the last step by its name, such as `torque`, `error` or `measurement`; null where there is none. */
const double *@NAME@_signal(const struct @NAME@_controller *controller, const char *name, int *size);

/* The scenario's reference at a step; after its end the last sample. In a separate file, which is optional. */
void @NAME@_reference(long step, double *reference);

#ifdef __cplusplus
}
#endif

#endif
