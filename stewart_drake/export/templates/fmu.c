/* A co-simulation unit, FMI @FMI@.0, around @WHAT@: inputs hold from one communication point to the next. */
#include "@HEADER@"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR };
typedef void logger(void); /* of the importer; its type is that of FMI @FMI@.0 */
#define MOST_STEPS 1e7     /* of one call: more would seem never to return */
static const double period = @PERIOD@; /* [s] of a step */

typedef struct {
    struct @STRUCT@ inner;
@FIELDS@
    double steps; /* done */
    double now;   /* [s] the communication point that was reached last */
    void *environment;
    logger *log;
    char name[64];
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
    unit empty = {.environment = u->environment, .log = u->log};
    memcpy(empty.name, u->name, sizeof empty.name);
    *u = empty;
    @INIT@
@START@
}

static bool step(unit *u)
{
    @STEP@
}

/* A unit that has begun; NULL without memory. */
static unit *made(const char *name, void *environment, logger *log)
{
    unit *u = calloc(1, sizeof *u);
    if (u != NULL) {
        strncpy(u->name, name == NULL ? "@NAME@" : name, sizeof u->name - 1);
        u->environment = environment;
        u->log = log;
        begin(u);
    }
    return u;
}

static int get(const unit *u, const uint32_t *references, size_t count, double *values, size_t size)
{
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
            const char *from = references[k] == 0 ? NULL : (const char *)u + variables[references[k] - 1].at;
            values[done] = from == NULL ? u->steps * period : ((const double *)from)[m];
        }
    }
    return OK;
}

static int set(unit *u, const uint32_t *references, size_t count, const double *values, size_t size)
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

/* Steps to the next communication point; `why` is the reason if a step fails, else NULL. */
static int advance(unit *u, double now, double size, const char **why)
{
    const double end = now + size, about = 1e-3 * period;
    *why = NULL;
    /* A step goes on from the last one, and forwards: comparisons with what is no number are false. */
    if (!(now > u->now - about && now < u->now + about && size > 0.0 && size <= MOST_STEPS * period)) {
        return ERROR;
    }
    /* So many steps that the next communication point is reached; a point may be off by rounding. */
    while (u->steps * period < end - 0.5 * period) {
        if (!step(u)) {
            int leg = -1;
            *why = @WHY@(&u->inner, &leg);
            return ERROR;
        }
    }
    u->now = end;
    return OK;
}

@API@