"""Pose and rate of the platform from the motor encoders alone."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.compiled.constants import CHAIN_STATE, ESTIMATOR_MEMORY, ESTIMATOR_NUMBERS, SAME_BRANCH, filled
from stewart_drake.errors import (
    AssemblyModeError,
    RunFailure,
    SingularPoseError,
    UnreachablePoseError,
    pose_text,
)
from stewart_drake.hardware.seeded import tick_normal
from stewart_drake.hardware.sensing import Estimate, LoopSite
from stewart_drake.hardware.sensor_faults import EncoderFault, SensorOptions, faulty_sensor
from stewart_drake.mechanics.kinematics import (
    crank_rates,
    forward_kinematics,
    leg_geometry,
    rod_lines,
    twist_to_pose_rate,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LARGEST
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.sampling import WELL, Running, Sampled
from stewart_drake.section import Natural, NotNegative, Positive, PositivePair, Seed, Vector6

_M = ESTIMATOR_MEMORY
MEMORY_SIZE: int = _M.size
"""Pose 6, pose rate 6, angles 6, crank rates 6, ticks held, sign of the assembly mode, ticks done (0 or 1)."""

_STREAM = 1
"""Of random numbers, see `seeded`."""

TOLERANCE = 1e-12
"""[m] rod-length error at which Newton's method stops."""
ITERATIONS = 12
"""Newton steps at most; a warm start needs two."""


class EncoderOptions(SensorOptions):
    """Motor encoders, and the estimator that knows nothing else."""

    kind: Literal["encoders"] = "encoders"
    resolution_bits: Annotated[Natural, Field(le=40)] = 17
    """Counts a turn: 2 to the power of this; 0 for encoders without steps."""
    offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad] reading minus true angle of each motor: an error of homing."""
    noise: Annotated[NotNegative, Field(le=LARGEST)] = 0.0
    """[rad] standard deviation of each reading, before it is rounded to counts; independent from tick to tick."""
    noise_seed: Seed = 0
    """Of the noise."""
    faults: tuple[EncoderFault, ...] = ()
    """Encoders that fail, in order: each acts on what those before it left of the readings."""
    rate_cutoff: Positive | None = None
    """[Hz] crank rates are differences over one tick through a low pass of first order with this corner; null: bare."""
    max_speed: Positive = 60.0
    """[rad/s] a reading that has moved faster than this is rejected."""
    max_step: Annotated[PositivePair, LENGTH] = (0.2, 0.05)
    """[rad, m] a pose further than this from the last one, at first from the start, is rejected: Newton has found
    another assembly mode."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Ticks in a row for which the last good pose stands in for one that is not believed, before the run ends."""

    @cached_property
    def quantum(self) -> float:
        """[rad] of one count; 0 for none."""
        return 2.0 * math.pi / 2.0**self.resolution_bits if self.resolution_bits else 0.0

    @property
    def reading_noise(self) -> float:
        """[rad] standard deviation of a reading: noise, and rounding to counts as noise."""
        return math.hypot(self.noise, self.quantum / math.sqrt(12.0))

    def read(self, crank_angles: np.ndarray, tick: int | None = None) -> np.ndarray:
        """What the encoders say, while none fails.

        Args:
            crank_angles: (..., 6) [rad] true.
            tick: Whose noise it has; None for none.

        Returns:
            (..., 6) [rad].
        """
        angles = crank_angles + self.read_offset
        if tick is not None and self.noise > 0.0:
            angles = angles + self.noise * tick_normal(self.noise_seed, _STREAM, tick, 6)
        return np.rint(angles / self.quantum) * self.quantum if self.quantum else angles

    def reader(self, compiled: bool) -> Callable[[np.ndarray, int], np.ndarray]:
        """`read` of angles (6,) at a tick, compiled or not."""
        if not compiled:
            return self.read
        # numba takes half a second to import, and compiles on first use.
        from stewart_drake.compiled.estimator import read

        offset, quantum, nothing = self.read_offset, self.quantum, np.zeros(6)

        def fast(crank_angles: np.ndarray, tick: int) -> np.ndarray:
            result = np.empty(6)
            drawn = tick_normal(self.noise_seed, _STREAM, tick, 6) if self.noise > 0.0 else nothing
            read(crank_angles, offset, self.noise, drawn, quantum, result)
            return result

        return fast

    @cached_property
    def read_offset(self) -> np.ndarray:
        """`offset` (6,) [rad] as an array."""
        return np.array(self.offset)

    def smoothing(self, period: float) -> float:
        """Share of a new difference in the filtered crank rate, 1 without a low pass."""
        return 1.0 if self.rate_cutoff is None else 1.0 - math.exp(-2.0 * math.pi * self.rate_cutoff * period)


FlatEstimate = Callable[[np.ndarray, np.ndarray], np.ndarray]


def initial_memory(pose: np.ndarray, crank_rates: np.ndarray | None = None) -> np.ndarray:
    """Memory (27,) before the first tick.

    Args:
        pose: (6,) [rad, m] roughly where the platform stands.
        crank_rates: (6,) [rad/s] of a robot that is in motion at the start; None for one at rest.
    """
    memory = np.zeros(MEMORY_SIZE)
    memory[: _M.rate] = pose
    memory[_M.crank_rates : _M.held] = 0.0 if crank_rates is None else crank_rates
    return memory


def estimate(
    robot: RobotParameters, options: EncoderOptions, period: float, angles: np.ndarray, memory: np.ndarray
) -> np.ndarray:
    """One tick: forward kinematics from the last pose, and the pose's rate from the difference of the angles.

    Two readings one tick apart belong to the middle of the tick, so that the rate lags by half a period. The first tick
    has one reading; it repeats the crank rates of `initial_memory`. A pose is
    believed if no angle has jumped, Newton's method converges near the last pose, and the rods' lines have not changed
    orientation: between two assembly modes lies a parallel singularity, where their determinant changes sign. The
    cranks must stand on the robot's branch of the inverse kinematics, which ends at their dead centres.

    Args:
        robot: Geometry.
        options: See `EncoderOptions`.
        period: [s].
        angles: (6,) [rad] readings.
        memory: (27,) of the tick before, see `MEMORY_SIZE`; its first 12 are the measurement.

    Returns:
        (27,) of this tick.

    Raises:
        RunFailure: Readings that are not finite, or have jumped.
        ForwardKinematicsError: Newton's method does not converge.
        AssemblyModeError: The pose found is not near the last one (at first: the start), or in another assembly mode.
        SingularPoseError: A crank at its dead centre or beyond, or rods at a parallel singularity.
    """
    started = memory[_M.started] > 0.0
    if not np.isfinite(angles).all():
        raise RunFailure(f"encoder readings {pose_text(angles)}: not finite", reason="encoder")
    if started and np.abs(angles - memory[_M.angles : _M.crank_rates]).max() > options.max_speed * period * (
        1.0 + memory[_M.held]
    ):
        text = f"encoder readings {pose_text(angles)}: changed faster than {options.max_speed:g} rad/s"
        raise RunFailure(text, reason="encoder")
    guess = memory[: _M.rate]
    pose = forward_kinematics(robot, angles, guess, TOLERANCE, ITERATIONS)
    try:
        legs = leg_geometry(robot, pose)
    except UnreachablePoseError as error:
        # A crank carried across its dead centre, slightly.
        raise SingularPoseError("serial", pose, error.margin, 0.0, error.leg) from None
    beyond = np.cos(legs.crank_angles - angles) < SAME_BRANCH
    if beyond.any():
        leg = int(beyond.argmax())
        raise SingularPoseError("serial", pose, -float(abs(legs.transmission[leg])), 0.0, leg)
    lines = rod_lines(legs)
    sign = math.copysign(1.0, np.linalg.det(lines))
    step = np.abs(pose - guess) / np.repeat(options.max_step, 3)
    if (started and sign != memory[_M.side]) or step.max() > 1.0:
        raise AssemblyModeError(pose, guess)
    rate = memory[_M.crank_rates : _M.held]
    if started:
        difference = (angles - memory[_M.angles : _M.crank_rates]) / (period * (1.0 + memory[_M.held]))
        rate = rate + options.smoothing(period) * (difference - rate)
    try:
        twist = np.linalg.solve(lines, robot.crank_lengths * legs.transmission * rate)
    except np.linalg.LinAlgError:
        raise SingularPoseError("parallel", pose, 0.0, 0.0) from None
    return np.concatenate([pose, twist_to_pose_rate(pose, twist), angles, rate, [0.0, sign, 1.0]])


def held_estimate(
    robot: RobotParameters, options: EncoderOptions, period: float, angles: np.ndarray, memory: np.ndarray
) -> np.ndarray:
    """`estimate`, where up to `hold_ticks` failures in a row are bridged by the last good pose and rate.

    Raises:
        RunFailure: As `estimate`, where no good tick came before or they failed too often in a row.
    """
    try:
        return estimate(robot, options, period, angles, memory)
    except RunFailure:
        if memory[_M.started] == 0.0 or memory[_M.held] >= options.hold_ticks:
            raise
    held = memory.copy()
    held[_M.held] += 1.0
    return held


def flat_estimate(robot: RobotParameters, options: EncoderOptions, period: float, compiled: bool) -> FlatEstimate:
    """`held_estimate` as a function of angles (6,) and memory (27,) alone, compiled or not."""
    if not compiled:
        return lambda angles, memory: held_estimate(robot, options, period, angles, memory)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import estimator, mechanism

    packed = mechanism.pack(robot)
    numbers = filled(
        ESTIMATOR_NUMBERS,
        period=period,
        smoothing=options.smoothing(period),
        max_speed=options.max_speed,
        max_turn=options.max_step[0],
        max_shift=options.max_step[1],
        tolerance=TOLERANCE,
        iterations=ITERATIONS,
    )

    def tick(angles: np.ndarray, memory: np.ndarray) -> np.ndarray:
        result = np.empty(MEMORY_SIZE)
        if estimator.estimate(packed, numbers, angles, memory, result) == mechanism.OK:
            return result
        # Rare: the reference says what was wrong, and bridges it.
        return held_estimate(robot, options, period, angles, memory)

    return tick


def starting_crank_rates(robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
    """Crank rates (6,) [rad/s] of the robot, as believed, at a pose; zeros where it cannot stand there."""
    # In that case the first tick says so, with a log.
    with contextlib.suppress(UnreachablePoseError), np.errstate(all="ignore"):
        rates = crank_rates(robot, leg_geometry(robot, pose), pose, pose_rate)
        if np.isfinite(rates).all():
            return rates
    return np.zeros(6)


class EncoderSensing:
    """`EncoderOptions` in one run; see `Sensing`."""

    size = 6
    live = False

    def __init__(self, options: EncoderOptions, site: LoopSite) -> None:
        self._read = options.reader(site.compiled)
        self._faulty = Running(faulty_sensor(options.faults, 6, site.period)) if options.faults else None
        self.angles: np.ndarray | None = None

    def __call__(self, time: float, tick: int, state: np.ndarray) -> np.ndarray:
        """See `Sensing`."""
        angles = self._read(state[CHAIN_STATE.angles : CHAIN_STATE.anchor], tick)
        self.angles = angles if self._faulty is None else self._faulty(time, angles, time)[:6]
        return self.angles


class DifferenceEstimating:
    """`DifferenceOptions` in one run; see `Estimating`."""

    ahead = 0
    surprise_scale = None

    def __init__(self, options: object, site: LoopSite, sensors: Any, size: int) -> None:  # noqa: ARG002 - none matter
        self.live, self._estimate = size == 12, None
        if not self.live:
            rates = starting_crank_rates(site.robot, site.pose, site.pose_rate)
            tick = flat_estimate(site.robot, sensors, site.period, site.compiled)
            self._estimate = Running(Sampled(initial_memory(site.pose, rates), tick), site.guarded)

    @property
    def health(self) -> tuple[float, float]:
        """See `Estimating`."""
        return WELL if self._estimate is None else self._estimate.health

    def __call__(
        self,
        time: float,
        reading: np.ndarray,
        sent: np.ndarray,  # noqa: ARG002
        reference: np.ndarray,  # noqa: ARG002
        disturbance: np.ndarray | None,  # noqa: ARG002
    ) -> Estimate:
        """See `Estimating`."""
        found = reading if self._estimate is None else self._estimate(time, reading)[:12]
        return Estimate(found, found)
