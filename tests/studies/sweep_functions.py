"""What the workers of the sweep tests run: they import it, so it stands in a module of its own."""

import dataclasses
import os
import signal
import sys
from pathlib import Path

from stewart_drake.studies.runs import simulate


def with_function(study, function):
    return dataclasses.replace(study, trials=[dataclasses.replace(trial, function=function) for trial in study.trials])


def number(scenario):
    return int(scenario.name.rpartition(" ")[2])


def faulty(scenario):
    if number(scenario) == 1:
        raise ZeroDivisionError("mine")
    if number(scenario) == 2:
        sys.exit(7)
    return simulate(scenario)


def deadly(scenario):
    if number(scenario) == 1:
        os._exit(0)
    if number(scenario) == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    return simulate(scenario)


def killed_once(scenario):
    mark = Path(os.environ["SWEEP_TEST_MARK"])
    if number(scenario) == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return simulate(scenario)
