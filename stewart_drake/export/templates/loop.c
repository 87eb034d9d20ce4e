@LAWS@

/* All signals and states. */
struct loop {
@MEMBERS@
};

static const struct loop initial = {
@INITIAL@
};

@RUNS@

/* The parts that are due, but those of the end of a tick. Returns 0, or which part failed, counted from 1. */
static int run_parts(struct loop *loop)
{
    int status = 0;
    (void)loop;
@PARTS@
    return status;
}

/* What acts from the next tick on. Returns 0, or which part failed, counted from 1. */
static int end_parts(struct loop *loop)
{
    int status = 0;
    (void)loop;
@ENDS@
    return status;
}

static const struct {
    const char *name;
    int size;
} signals[] = {
@SIGNALS@
};

static const double *signal_at(const struct loop *loop, int k)
{
    switch (k) {
@POINTERS@
    default: return 0;
    }
}
