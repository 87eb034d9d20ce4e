typedef void log3(void *environment, int status, const char *category, const char *message);

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging, bool events, bool early,
    const uint32_t *required, size_t count, void *environment, log3 *log, void *update)
{
    (void)token, (void)resources, (void)visible, (void)logging, (void)early, (void)required, (void)count;
    (void)update;
    return events ? NULL : made(name, environment, (logger *)log);
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

EXPORTED int fmi3GetFloat64(void *u, const uint32_t *references, size_t count, double *values, size_t size)
{
    return get(u, references, count, values, size);
}

EXPORTED int fmi3SetFloat64(void *u, const uint32_t *references, size_t count, const double *values, size_t size)
{
    return set(u, references, count, values, size);
}

EXPORTED int fmi3DoStep(
    void *of, double now, double size, bool final, bool *event, bool *terminate, bool *early, double *last)
{
    unit *u = of;
    const char *why;
    const int status = advance(u, now, size, &why);
    (void)final;
    *event = *early = false;
    *terminate = why != NULL;
    *last = why != NULL ? u->steps * period : u->now;
    if (why != NULL && u->log != NULL) {
        ((log3 *)u->log)(u->environment, ERROR, "logStatusError", why);
    }
    return status;
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
