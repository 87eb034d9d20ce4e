typedef void log2(void *environment, const char *name, int status, const char *category, const char *message, ...);

/* What the importer offers. */
struct callbacks {
    log2 *log;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
};

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED void *fmi2Instantiate(
    const char *name, int type, const char *token, const char *resources, const struct callbacks *callbacks,
    int visible, int logging)
{
    enum { CO_SIMULATION = 1 };
    (void)token, (void)resources, (void)visible, (void)logging;
    if (type != CO_SIMULATION || callbacks == NULL) {
        return NULL;
    }
    return made(name, callbacks->environment, (logger *)callbacks->log);
}

EXPORTED void fmi2FreeInstance(void *u) { free(u); }

EXPORTED int fmi2SetDebugLogging(void *u, int on, size_t count, const char *const *categories)
{
    (void)u, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORTED int fmi2SetupExperiment(void *u, int has, double tolerance, double start, int ends, double stop)
{
    (void)u, (void)has, (void)tolerance, (void)ends, (void)stop;
    return start == 0.0 ? OK : ERROR;
}

EXPORTED int fmi2EnterInitializationMode(void *u)
{
    (void)u;
    return OK;
}

EXPORTED int fmi2ExitInitializationMode(void *u)
{
    (void)u;
    return OK;
}

EXPORTED int fmi2Terminate(void *u)
{
    (void)u;
    return OK;
}

EXPORTED int fmi2Reset(void *u)
{
    begin(u);
    return OK;
}

EXPORTED int fmi2GetReal(void *u, const uint32_t *references, size_t count, double *values)
{
    return get(u, references, count, values, count);
}

EXPORTED int fmi2SetReal(void *u, const uint32_t *references, size_t count, const double *values)
{
    return set(u, references, count, values, count);
}

EXPORTED int fmi2DoStep(void *of, double now, double size, int final)
{
    unit *u = of;
    const char *why;
    const int status = advance(u, now, size, &why);
    (void)final;
    if (why != NULL && u->log != NULL) {
        ((log2 *)u->log)(u->environment, u->name, ERROR, "logStatusError", "%s", why);
    }
    return status;
}

/* What a unit need not have. */
#define NONE(name) \
    EXPORTED int fmi2##name(void) { return ERROR; }
NONE(GetInteger) NONE(GetBoolean) NONE(GetString) NONE(SetInteger) NONE(SetBoolean) NONE(SetString)
NONE(GetFMUstate) NONE(SetFMUstate) NONE(FreeFMUstate) NONE(SerializedFMUstateSize) NONE(SerializeFMUstate)
NONE(DeSerializeFMUstate) NONE(GetDirectionalDerivative) NONE(SetRealInputDerivatives) NONE(GetRealOutputDerivatives)
NONE(CancelStep) NONE(GetStatus) NONE(GetRealStatus) NONE(GetIntegerStatus) NONE(GetBooleanStatus)
NONE(GetStringStatus)
