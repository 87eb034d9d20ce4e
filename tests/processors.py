"""The same on every processor: the contract, and tests that state numbers, with the arithmetic of other processors.

    python tests/processors.py             # all settings; status 1 if one of them differs
    python tests/processors.py Haswell     # one, or several

A setting is environment variables. They choose numba's machine code, OpenBLAS's kernels, numpy's loops and the C
library's functions, whose results differ in the last digits. `make processors`; some minutes a setting.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

TESTS = Path(__file__).resolve().parent
# What this processor has beyond the least that numpy needs.
FOUND = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
AVX512 = [name for name in FOUND if "AVX512" in name or name == "X86_V4"]

SETTINGS = {
    "native": {},
    "generic": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "numpy without AVX2": {"NPY_DISABLE_CPU_FEATURES": " ".join(FOUND)},
    "C library without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"},
}
# All at once: the arithmetic of a processor of 2008.
OLDEST = ("generic", "Nehalem", "numpy without AVX2", "C library without FMA")
SETTINGS["oldest"] = {key: value for name in OLDEST for key, value in SETTINGS[name].items()}
if AVX512:
    SETTINGS |= {
        "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
        "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": " ".join(AVX512)},
    }

# Fast tests of the rooms whose tests state numbers, and the page that tells of rounding errors.
ROOMS = ["mechanics", "control", "hardware", "analysis", "plant"]
PYTEST = ["-m", "pytest", "-q", "-n", "2", "--hypothesis-profile=check"]
CHECKS = {
    "golden": ["golden_set.py", "check"],
    "tests": [*PYTEST, "-m", "not slow and not long", *ROOMS],
    "page": [*PYTEST, "test_results_pages.py::test_reproduction"],
}


def main(*names):
    failed = 0
    if unknown := set(names) - SETTINGS.keys():
        sys.exit(f"expected settings that this processor has, {', '.join(SETTINGS)}; got {', '.join(unknown)}")
    for name in names or SETTINGS:
        for check, arguments in CHECKS.items():
            start = time.monotonic()
            environment = {**os.environ, **SETTINGS[name], "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            command = [sys.executable, *arguments]
            done = subprocess.run(command, cwd=TESTS, env=environment, capture_output=True, text=True, check=False)
            print(f"{name}, {check}: {'differs' if done.returncode else 'agrees'}, {time.monotonic() - start:.0f} s")
            if done.returncode:
                print(done.stdout, done.stderr, sep="\n")
                failed = 1
            sys.stdout.flush()
    return failed


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
