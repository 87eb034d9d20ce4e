"""Monte Carlo by Drake: `MonteCarloSimulation` over robots and starts that are drawn as a sweep draws them.

Prints a row for each sample. A sample is a run of the sweep, whose number is the first number of its generator.
"""

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation
from pydrake.systems.framework import Context

from stewart_drake import ClosedLoop
from stewart_drake.studies.sweep import load_sweep, make_simulator

SWEEP = "initial_offset"
SAMPLES = 6
DURATION = 1.0  # [s]


def error(loop: ClosedLoop, context: Context) -> float:
    """RMS error of the platform's place [mm] in the second half."""
    errors = loop.sinks["error"].FindLog(context).data()[3:]
    return float(1e3 * np.sqrt(np.mean(np.sum(errors[:, errors.shape[1] // 2 :] ** 2, axis=0))))


def main() -> None:
    """Draws, runs, prints."""
    sweep = load_sweep(SWEEP)
    print("       run   platform [kg]   start, Z off by [mm]   error [mm]")
    for sample in MonteCarloSimulation(make_simulator(sweep), error, DURATION, SAMPLES, RandomGenerator(1)):
        number = sample.generator_snapshot()
        scenario = sweep.trials.trial(number).scenario()
        mass, off = scenario.robot.platform_mass, 1e3 * scenario.initial_offset[5]
        print(f"{number:10d}   {mass:13.3f}   {off:20.2f}   {sample.output:10.3f}")


if __name__ == "__main__":
    main()
