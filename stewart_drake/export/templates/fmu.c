/* An FMI 3.0 co-simulation unit around @WHAT@: inputs hold from one communication point to the next. */
#include "@HEADER@"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR };
#define MOST_STEPS 1e7 /* of one call: more would seem never to return */
static const double period = @PERIOD@; /* [s] of a step */

typedef struct {
    struct @STRUCT@ inner;
@FIELDS@
    double steps; /* done */
    double now;   /* [s] the communication point that was reached last */
    void *environment;
    void (*log)(void *environment, int status, const char *category, const char *message);
} unit;

/* Variables by their references, from 1; 0 is the time. */
static const struct {
    size_t at;
    size_t size;
    bool input;
} variables[] = {
@TABLE@
};

enum { VARIABLES = sizeof variables / sizeof variables[0] };

static void begin(unit *u)
{
    *u = (unit){.environment = u->environment, .log = u->log};
    @INIT@
@START@
}

static bool step(unit *u)
{
    @STEP@
}

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging, bool events, bool early,
    const uint32_t *required, size_t count, void *environment,
    void (*log)(void *environment, int status, const char *category, const char *message), void *update)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)early, (void)required, (void)count;
    (void)update;
    unit *u = events ? NULL : calloc(1, sizeof *u);
    if (u != NULL) {
        u->environment = environment;
        u->log = log;
        begin(u);
    }
    return u;
}

EXPORTED void fmi3FreeInstance(void *u) { free(u); }

EXPORTED int fmi3SetDebugLogging(void *u, bool on, size_t count, const char *const *categories)
{
    (void)u, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORTED int fmi3EnterInitializationMode(void *u, bool has, double tolerance, double start, bool ends, double stop)
{
    (void)u, (void)has, (void)tolerance, (void)ends, (void)stop;
    return start == 0.0 ? OK : ERROR;
}

EXPORTED int fmi3ExitInitializationMode(void *u)
{
    (void)u;
    return OK;
}

EXPORTED int fmi3Terminate(void *u)
{
    (void)u;
    return OK;
}

EXPORTED int fmi3Reset(void *u)
{
    begin(u);
    return OK;
}

EXPORTED int fmi3GetFloat64(void *of, const uint32_t *references, size_t count, double *values, size_t size)
{
    unit *u = of;
    size_t done = 0;
    for (size_t k = 0; k < count; k++) {
        if (references[k] > VARIABLES) {
            return ERROR;
        }
        const size_t n = references[k] == 0 ? 1 : variables[references[k] - 1].size;
        if (done + n > size) {
            return ERROR;
        }
        for (size_t m = 0; m < n; m++, done++) {
            const double *from = references[k] == 0 ? NULL : (double *)((char *)u + variables[references[k] - 1].at);
            values[done] = from == NULL ? u->steps * period : from[m];
        }
    }
    return OK;
}

EXPORTED int fmi3SetFloat64(void *u, const uint32_t *references, size_t count, const double *values, size_t size)
{
    size_t done = 0;
    for (size_t k = 0; k < count; k++) {
        if (references[k] == 0 || references[k] > VARIABLES || !variables[references[k] - 1].input) {
            return ERROR;
        }
        double *to = (double *)((char *)u + variables[references[k] - 1].at);
        for (size_t m = 0; m < variables[references[k] - 1].size; m++, done++) {
            if (done >= size) {
                return ERROR;
            }
            to[m] = values[done];
        }
    }
    return OK;
}

EXPORTED int fmi3DoStep(
    void *of, double now, double size, bool final, bool *event, bool *terminate, bool *early, double *last)
{
    unit *u = of;
    const double end = now + size, about = 1e-3 * period;
    (void)final;
    *event = *terminate = *early = false;
    *last = u->now;
    /* A step goes on from the last one, and forwards: comparisons with what is no number are false. */
    if (!(now > u->now - about && now < u->now + about && size > 0.0 && size <= MOST_STEPS * period)) {
        return ERROR;
    }
    /* So many steps that the next communication point is reached; a point may be off by rounding. */
    while (u->steps * period < end - 0.5 * period) {
        if (!step(u)) {
            int leg = -1;
            *terminate = true;
            if (u->log != NULL) {
                u->log(u->environment, ERROR, "logStatusError", @WHY@(&u->inner, &leg));
            }
            *last = u->steps * period;
            return ERROR;
        }
    }
    *last = u->now = end;
    return OK;
}

/* What a unit need not have. */
#define NONE(name) \
    EXPORTED int fmi3##name(void) { return ERROR; }
#define BOTH(type) NONE(Get##type) NONE(Set##type)
BOTH(Float32) BOTH(Int8) BOTH(UInt8) BOTH(Int16) BOTH(UInt16) BOTH(Int32) BOTH(UInt32) BOTH(Int64) BOTH(UInt64)
BOTH(Boolean) BOTH(String) BOTH(Binary) BOTH(Clock) BOTH(FMUState) BOTH(IntervalDecimal) BOTH(IntervalFraction)
BOTH(ShiftDecimal) BOTH(ShiftFraction) BOTH(ContinuousStates)
NONE(EnterEventMode) NONE(EnterStepMode) NONE(EnterConfigurationMode) NONE(ExitConfigurationMode) NONE(SetTime)
NONE(EnterContinuousTimeMode) NONE(CompletedIntegratorStep) NONE(UpdateDiscreteStates) NONE(EvaluateDiscreteStates)
NONE(FreeFMUState) NONE(SerializedFMUStateSize) NONE(SerializeFMUState) NONE(DeserializeFMUState)
NONE(GetDirectionalDerivative) NONE(GetAdjointDerivative) NONE(GetNumberOfVariableDependencies)
NONE(GetVariableDependencies) NONE(GetContinuousStateDerivatives) NONE(GetEventIndicators)
NONE(GetNominalsOfContinuousStates) NONE(GetNumberOfEventIndicators) NONE(GetNumberOfContinuousStates)
NONE(GetOutputDerivatives) NONE(ActivateModelPartition)

EXPORTED void *fmi3InstantiateModelExchange(void) { return NULL; }
EXPORTED void *fmi3InstantiateScheduledExecution(void) { return NULL; }
