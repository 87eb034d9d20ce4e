"""Exported sources, compiled and called."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
CHECKED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compiler(name="gcc"):
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    return name


def compiled(folder, *sources, flags=("-O0",), output="it.so", cc="gcc"):
    shared = () if output == "it" else ("-shared", "-fPIC")
    command = [compiler(cc), *STRICT, *flags, *shared, "-o", output, *sources, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:4000]
    return folder / output


def pointer(values):
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


class InC:
    """An exported controller, to be called as `Controller` is."""

    def __init__(self, folder, name, flags=("-O0",)):
        header = (folder / f"{name}.h").read_text()
        self.memory = np.zeros(int(header.split("memory[")[1].split("]")[0]))
        self.library, self.name = (
            ctypes.CDLL(str(compiled(folder, f"{name}.c", f"{name}_reference.c", flags=flags))),
            name,
        )
        self._step = self._function("step", ctypes.c_int)
        self._signal = self._function("signal", ctypes.POINTER(ctypes.c_double))
        self.reset()

    def _function(self, name, result=None):
        function = getattr(self.library, f"{self.name}_{name}")
        function.restype = result
        return function

    def reset(self):
        self._function("reset")(pointer(self.memory))

    def step(self, reading, reference, out, age=0.0):
        given = np.ascontiguousarray(reading, dtype=float), np.ascontiguousarray(reference, dtype=float)
        return self._step(pointer(self.memory), *map(pointer, given), ctypes.c_double(age), pointer(out))

    def signal(self, name):
        size = ctypes.c_int()
        at = self._signal(pointer(self.memory), name.encode(), ctypes.byref(size))
        return np.array(at[: size.value]) if at else None

    def reference(self, step, size):
        out = np.empty(size)
        self._function("reference")(ctypes.c_long(step), pointer(out))
        return out
