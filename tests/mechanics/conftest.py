import os

from hypothesis import settings

# The laws as plain Python are hundreds of times slower.
if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
    settings.register_profile("uncompiled", deadline=None, max_examples=4)
    settings.load_profile("uncompiled")
