"""What the workers of the sweep tests run: they import it, so it stands in a module of its own."""

import copy
import dataclasses
import os
import signal
import sys

from stewart_drake.studies.runs import simulate


def with_function(study, function):
    """The study with another function in the place of `simulate`."""
    made = copy.copy(study)
    object.__setattr__(made, "task", lambda index: dataclasses.replace(study.task(index), function=function))
    return made


def number(scenario):
    return int(scenario.name.rpartition(" ")[2])


def faulty(scenario):
    """Run 1 raises, 2 exits, 3 recurses too deep, 4 runs out of memory; the others are simulated."""
    what = number(scenario)
    if what == 1:
        raise ZeroDivisionError("mine")
    if what == 2:
        sys.exit(7)
    if what == 3:
        raise RecursionError
    if what == 4:
        raise MemoryError
    return simulate(scenario)


def deadly(scenario):
    """Runs 1 and 4 end their process, by `os._exit` and by SIGKILL; the others are simulated."""
    what = number(scenario)
    if what == 1:
        os._exit(0)
    if what == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    return simulate(scenario)


def killed_once(scenario):
    """Run 2 kills its process the first time that it is run; a file named by the environment remembers."""
    if number(scenario) == 2:
        try:
            os.close(os.open(os.environ["SWEEP_TEST_MARK"], os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return simulate(scenario)
        os.kill(os.getpid(), signal.SIGKILL)
    return simulate(scenario)
