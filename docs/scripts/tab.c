/* A robot with its motors, sensors and controller as a module of WebAssembly; docs/scripts/tab.py fills in the loop. */
#include <math.h>
#include <stdbool.h>

@LOOP@

static struct loop the_loop;

double *tab_memory(void) { return (double *)&the_loop; }

static void measure(struct loop *loop)
{
    for (int k = 0; k < 6; k++) {
        loop->measured[k] = loop->plant.pose[k];
        loop->measured[6 + k] = loop->plant.pose_rate[k];
        loop->measured[12 + k] = loop->plant.angles[k];
        loop->measured[18 + k] = loop->plant.crank_rate[k];
    }
}

void tab_begin(void)
{
    the_loop = initial;
    measure(&the_loop);
}

/* A step of the plant; 0, or which part failed, counted from 1. */
int tab_step(void)
{
    struct loop *loop = &the_loop;
    loop->time[0] = loop->steps * @STEP@;
    int status = run_parts(loop);
    if (status == 0) {
        status = end_parts(loop);
        measure(loop);
        loop->steps += 1.0;
    }
    return status;
}

/* Whether a hand may ask for the pose at `asked`. */
int tab_allowed(void)
{
    (void)signals;
    (void)signal_at;
    run_check(&the_loop);
    return the_loop.check.allowed > 0.0;
}
