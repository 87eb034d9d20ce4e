"""The nine experiments of section III.D, run in the Diagram."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from stewart_drake.config import Vector6
from stewart_drake.control.network import DensityKind, density
from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.logs.log import SimulationLog
from stewart_drake.planning.feasibility import amplitude_table, largest_scale
from stewart_drake.planning.limits import Limits
from stewart_drake.references import SineBurstsReference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import AnnTuner, FixedTuner, Scenario
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.workers import Workers, run_jobs
from stewart_drake.training.dataset import Dataset

OMEGAS = (0.1, 1.0, 10.0)
"""Values of omega_Q and of omega_R; their nine pairs are the experiments."""
FREQUENCIES = (1.0, 2.0, 3.0, 4.0, 5.0)
"""[Hz] one burst each, in every experiment."""
PHASES = tuple(np.pi / 3.0 * k for k in range(6))
"""[rad] of the six axes: sixty degrees apart, so that they do not peak together."""
SHARE = 0.8
"""Share of the largest feasible amplitudes that is used: at the whole of it the weaker of the nine pairs overshoot into
a crank's dead centre."""
SAMPLES_PER_RUN = 1600
BURST = 1.6
"""[s] of each frequency: 320 samples of 5 ms."""


@lru_cache(maxsize=4)
def feasible_amplitudes(
    robot: RobotParameters, limits: Limits, gravity: float
) -> tuple[tuple[Vector6, ...], tuple[Vector6, ...]]:
    """Largest feasible amplitudes (n_f, 6) [rad, m] at each of `FREQUENCIES`: of each axis alone, and of all at once.

    All at once, `PHASES` apart, have the largest common share of those of each axis alone.
    """
    alone = tuple(six(row) for row in amplitude_table(robot, limits, FREQUENCIES, gravity))
    together = []
    for frequency, single in zip(FREQUENCIES, alone, strict=True):

        def burst(scale: float, frequency: float = frequency, single: Vector6 = single) -> SineBurstsReference:
            return _bursts(robot, (frequency,), (six(scale * np.array(single)),))

        together.append(six(largest_scale(robot, limits, burst, BURST, gravity) * np.array(single)))
    return alone, tuple(together)


def experiment_reference(base: Scenario) -> SineBurstsReference:
    """The motion of every experiment: 1 to 5 Hz on all six axes, `SHARE` of what the limits of `base` allow.

    Deviation: the paper's pi/6 and 0.3 m at up to 5 Hz cannot be reached together (0.3 m at 5 Hz is 296 m/s^2).

    Raises:
        ConfigurationError: The home pose itself is outside the limits of `base`, so there is no motion.
    """
    _, together = feasible_amplitudes(base.robot, base.limits, base.gravity)
    if not np.all(np.array(together) > 0.0):
        raise ConfigurationError("limits", base.limits, "limits within which the robot can move from its home pose")
    # To whole microradians and micrometres, downwards: rounding errors of the search then leave the data as it is.
    amplitude = tuple(six(np.floor(1e6 * SHARE * np.array(row)) / 1e6) for row in together)
    return _bursts(base.robot, FREQUENCIES, amplitude)


def _bursts(
    robot: RobotParameters, frequency: tuple[float, ...], amplitude: tuple[Vector6, ...]
) -> SineBurstsReference:
    return SineBurstsReference(
        frequency=frequency, amplitude=amplitude, center=six(robot.home_pose), phase=six(PHASES), burst_duration=BURST
    )


def experiment_scenarios(base: Scenario, samples: int = SAMPLES_PER_RUN) -> list[Scenario]:
    """The nine experiments of so many ticks: every pair of `OMEGAS` held fixed, on `experiment_reference`."""
    kept = {name: getattr(base, name) for name in ("gravity", "robot", "model_robot", "plant", "limits")}
    kept |= {"reference": experiment_reference(base), "controller": base.lqi, "duration": samples * base.lqi.period}
    kind, window = base.tuner.density, base.tuner.window
    return [
        Scenario(
            name=f"experiment {index}",
            tuner=FixedTuner(omega_q=omega_q, omega_r=omega_r, density=kind, window=window),
            **kept,
        )
        for index, (omega_q, omega_r) in enumerate(itertools.product(OMEGAS, OMEGAS))
    ]


def dataset_from_logs(
    logs: Sequence[SimulationLog], samples: int, kind: DensityKind, window: int, metadata: dict[str, Any]
) -> Dataset:
    """Densities of logged errors and torques, one row a tick; a log per experiment."""
    inputs, outputs = [], []
    for index, log in enumerate(logs):
        _refuse_part(index, log, samples)
        signals = np.concatenate([log["error"], log["torque"]], axis=1)[:samples]
        inputs.append([density(signals[max(0, k - window) : k + 1], kind) for k in range(samples)])
        outputs.append(log["weights"][:samples])
    run = np.repeat(np.arange(len(logs)), samples)
    times = np.concatenate([log.time[:samples] for log in logs])
    return Dataset(np.concatenate(inputs), np.concatenate(outputs), run, times, metadata)


def _refuse_part(index: int, log: SimulationLog, samples: int) -> None:
    """Raises a RunFailure where a run ended before its last sample."""
    if not log.reached_end or len(log.time) < samples:
        omega_q, omega_r = log.scenario.tuner.weights
        name = f"experiment {index} (omega_Q {omega_q:g}, omega_R {omega_r:g})"
        raise RunFailure(f"{name} ended at {log.end_time:.3f} s: {log.message}")


def dataset_metadata(base: Scenario, reference: SineBurstsReference) -> dict[str, Any]:
    """How the data was made: sample time, window, kind, amplitudes per frequency, and the whole scenario."""
    return {
        "sample_time": base.lqi.period,
        "density": base.tuner.density,
        "window": base.tuner.window,
        "frequency": list(reference.frequency),
        "amplitude": [list(row) for row in reference.amplitude],
        "phase": list(reference.phase),
        "gravity": base.gravity,
        "feedforward": base.lqi.feedforward,
        "force_map": base.lqi.force_map,
        "omegas": list(OMEGAS),
        "scenario": base.to_dict(),
    }


def collect_dataset(
    base: Scenario | None = None,
    progress: Callable[[float], None] | None = None,
    samples: int = SAMPLES_PER_RUN,
    where: Workers | None = None,
) -> Dataset:
    """Runs the nine experiments in the Diagram and gathers their densities.

    None for `base` takes the defaults (gravity on, `feedforward: gravity`, 5 ms); None for `where` runs them here, one
    after the other. `progress` is called with the number of experiments done.

    Raises:
        ConfigurationError: The tuner of `base` is fixed, or a key of it does not go with the experiments.
        RunFailure: An experiment ended early; it says which. The rest is not run.
        KeyboardInterrupt: After Ctrl-C, which `simulation.run` turns into a log.
    """
    base = Scenario() if base is None else base
    if not isinstance(base.tuner, AnnTuner):
        allowed = "paper: its density and window settings are those of the data"
        raise ConfigurationError("tuner.kind", base.tuner.kind, allowed)
    scenarios = experiment_scenarios(base, samples)
    reference = scenarios[0].reference
    assert isinstance(reference, SineBurstsReference)
    logs: dict[int, SimulationLog] = {}

    def keep(index: int, log: SimulationLog) -> None:
        _refuse_part(index, log, samples)
        logs[index] = log
        if progress is not None:
            progress(float(len(logs)))

    run_jobs(range(len(scenarios)), lambda index: (simulate, (scenarios[index],)), keep, where or Workers(0))
    ordered = [logs[index] for index in sorted(logs)]
    metadata = dataset_metadata(base, reference)
    return dataset_from_logs(ordered, samples, base.tuner.density, base.tuner.window, metadata)


def six(values: Any) -> Vector6:
    """Six plain floats out of an array or sequence."""
    a, b, c, d, e, f = (float(v) for v in values)
    return a, b, c, d, e, f
