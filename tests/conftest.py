import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from stewart_drake.base.atomic_files import seal
from stewart_drake.control.network import TunerNetwork
from stewart_drake.logs import versions
from stewart_drake.studies import workers

# A deadline would make the outcome depend on how busy the machine is.
settings.register_profile("default", deadline=None)
# In CI the same examples every time: a new counterexample is found by a person, not by somebody else's change.
settings.register_profile("ci", deadline=None, derandomize=True)
# For daily work, `make check`: a quarter of the examples; `make test` has all of them.
settings.register_profile("check", deadline=None, max_examples=25)
settings.load_profile("ci" if os.environ.get("CI") else "default")
if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
    # The laws as plain Python are hundreds of times slower.
    settings.register_profile("uncompiled", deadline=None, max_examples=4)
    settings.load_profile("uncompiled")


ROOT = Path(__file__).parent.parent


# Fixtures that take long. The tests of each go to one worker: others would make it again, or stand idle meanwhile.
SHARED = ("cluster", "done")


# Before that of pytest-xdist, which looks for the groups.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        for name in set(SHARED).intersection(item.fixturenames):
            item.add_marker(pytest.mark.xdist_group(name))
        if "report" in item.fixturenames:
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("torch") and importlib.util.find_spec("torch") is None:
            item.add_marker(pytest.mark.skip(reason="needs torch"))


COMMAND = "from stewart_drake.cli.app import main; main()"


def environment(**changes):
    # In which a fresh Python finds this checkout, installed or not.
    path = os.pathsep.join(filter(None, [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "200", "LC_ALL": "C.UTF-8", **changes}


def python(*arguments):
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=environment())
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def start(tmp_path):
    started = []

    def start(*args, code=COMMAND, **options):
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
        options = pipes | {"cwd": tmp_path, "env": environment()} | options
        started.append(subprocess.Popen([sys.executable, "-c", code, *map(str, args)], **options))
        return started[-1]

    yield start
    for process in started:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def shell(start):

    def shell(*args, **options):
        process = start(*args, **options)
        out, err = process.communicate(timeout=120)
        return process.returncode, out, err

    return shell


def field_of(error):
    return re.sub(r"(\.\d+)+$", "", error.key)


def make_network(seed=0, window=49, density="magnitude", gain=1.0):
    rng = np.random.default_rng(seed)
    return TunerNetwork(
        input_mean=rng.uniform(0.8, 1.2, 12),
        input_scale=rng.uniform(0.4, 0.9, 12),
        hidden_weights=gain * rng.normal(0.0, 0.5, (10, 12)),
        hidden_bias=rng.normal(0.0, 0.3, 10),
        output_weights=gain * rng.normal(0.0, 0.4, (2, 10)),
        output_bias=rng.normal(0.0, 0.3, 2),
        omega_min=np.array([0.1, 0.1]),
        omega_max=np.array([10.0, 10.0]),
        density=density,
        window=window,
        provenance={"made_by": "conftest", "seed": seed},
    )


def resealed(document):
    rest = {key: value for key, value in document.items() if key != "checksum"}
    try:
        rest = seal(rest)
    except ValueError:
        rest["checksum"] = "of NaN there is none"
    return json.dumps(rest).encode()


@pytest.fixture
def code_as_it_is(monkeypatch):
    # What is tested in this process must not depend on whether someone edits the package meanwhile.
    monkeypatch.setattr(versions, "source_digest", lambda: "as it is")
    workers._own_source.cache_clear()
    yield
    workers._own_source.cache_clear()


@pytest.fixture
def network():
    return make_network()


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*args):
        from stewart_drake.cli.app import main

        monkeypatch.setattr(sys, "argv", ["stewart-drake", *map(str, args)])
        status = 0
        try:
            main()
        except SystemExit as end:
            status = end.code
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return status, *capsys.readouterr()

    return call


if threading.current_thread() is threading.main_thread():
    # A shell's background job ignores Ctrl-C, and so would all that it starts: the tests of Ctrl-C would wait in vain.
    signal.signal(signal.SIGINT, signal.default_int_handler)
