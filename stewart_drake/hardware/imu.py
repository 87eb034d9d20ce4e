"""The inertial sensor on the platform (IMU): three gyroscopes and three accelerometers, from the true motion.

A reading is the mean of its period: angular velocity, and specific force (acceleration minus gravity) of the sensor's
place, both in the sensor's axes. The mean force follows from the change of the place's velocity, the same on any plant.
Both have the motion of the base, if it moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from stewart_drake.base.config import Natural, NotNegative, Period, Phase, Positive, Section, Seed, Share, Text
from stewart_drake.base.families import Table
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Record, Vec3, Vec6, Vec9, Vec12, record
from stewart_drake.base.sampling import on_grid, steps_per
from stewart_drake.hardware.faults import ImuFault, faulty_sensor_part, tick_numbers
from stewart_drake.hardware.motors import delay_part
from stewart_drake.loop.part import Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import add_base_acceleration
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.mechanics.linear_algebra import copy_to, set_to
from stewart_drake.robot.gravity import Gravity, base_reading
from stewart_drake.robot.leg import LARGEST_SIZE, Coordinate

_STREAM, _UNIT_STREAM = 5, 6  # Numbers of the streams of random numbers, see `faults.tick_numbers`.
_DEG, _G, _MICRO_G = math.radians(1.0), 9.80665, 9.80665e-6

# Bosch Sensortec, BMI088 data sheet (BST-BMI088-DS001): 0.014 deg/s/sqrt(Hz), 1 deg/s, 0.015 deg/s/K, 1 %; 160 to 190
# ug/sqrt(Hz), 20 mg, 0.2 mg/K. CEVA, BNO080/085 data sheet (1000-3927), figure "BNO080 performance": accuracy 3.1 deg/s
# and 0.3 m/s^2; noise as that of Bosch's BMI055, which is an estimate. InvenSense, MPU-6000/MPU-6050 product
# specification 3.4 (PS-MPU-6000A-00), 6.1 and 6.2: 0.005 deg/s/sqrt(Hz), 20 deg/s, 3 %, 400 ug/sqrt(Hz), 80 mg,
# 35 mg/70 K. Offsets there are limits or typical values; here they are two standard deviations. The drift is that of a
# temperature that wanders by a kelvin in a minute, an estimate.
PRESETS: dict[str, dict[str, float]] = {
    "bmi088": {},
    "bno085": {"gyro_bias": 1.55 * _DEG, "accelerometer_bias": 0.15, "accelerometer_noise": 150.0 * _MICRO_G}
    | {"accelerometer_range": 8.0 * _G, "delay": 0.002},
    "mpu6050": {"gyro_noise": 0.005 * _DEG, "gyro_bias": 10.0 * _DEG, "gyro_drift": 0.021 * _DEG, "scale_error": 0.015}
    | {"accelerometer_noise": 400.0 * _MICRO_G, "accelerometer_bias": 0.4, "accelerometer_drift": 65.0 * _MICRO_G}
    | {"gyro_range": 500.0 * _DEG, "accelerometer_range": 4.0 * _G},
}


class ImuOptions(Section, key="model.imu"):
    """An inertial sensor on the platform; the defaults are those of a BMI088."""

    preset: Annotated[Text, Table(dict(PRESETS))] | None = None
    """A commercial sensor, which sets the defaults of the other keys."""
    position: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    """[m] place of the sensor in the platform's frame P."""
    rotation: tuple[Phase, Phase, Phase] = (0.0, 0.0, 0.0)
    """[rad] roll, pitch and yaw of the sensor's axes in the platform's frame P."""
    period: Period | None = None
    """[s] between two readings, each a mean of this time; null for that of the encoders' readings."""
    delay: Annotated[NotNegative, Field(le=0.2)] = 0.0
    """[s] age of a reading when the controller gets it, from the end of its period."""
    gyro_noise: Annotated[NotNegative, Field(le=1.0)] = 0.014 * _DEG
    """[rad/s/sqrt(Hz)] noise density of the gyroscopes, one-sided."""
    gyro_bias: Annotated[NotNegative, Field(le=10.0)] = 0.5 * _DEG
    """[rad/s] standard deviation of the gyroscopes' offsets at the start."""
    gyro_drift: Annotated[NotNegative, Field(le=1.0)] = 0.002 * _DEG
    """[rad/s per sqrt(s)] random walk of the offsets."""
    gyro_range: Annotated[Positive, Field(le=LARGEST_SIZE)] = 1000.0 * _DEG
    """[rad/s] largest reading of a gyroscope."""
    accelerometer_noise: Annotated[NotNegative, Field(le=10.0)] = 175.0 * _MICRO_G
    """[m/s^2/sqrt(Hz)] noise density of the accelerometers, one-sided."""
    accelerometer_bias: Annotated[NotNegative, Field(le=10.0)] = 0.01 * _G
    """[m/s^2] standard deviation of the accelerometers' offsets at the start."""
    accelerometer_drift: Annotated[NotNegative, Field(le=1.0)] = 26.0 * _MICRO_G
    """[m/s^2 per sqrt(s)] random walk of the offsets."""
    accelerometer_range: Annotated[Positive, Field(le=LARGEST_SIZE)] = 6.0 * _G
    """[m/s^2] largest reading of an accelerometer."""
    bits: Annotated[Natural, Field(ge=6, le=32)] = 16
    """[bits] of a reading, over the range to both sides."""
    scale_error: Share = 0.005
    """[-] standard deviation of the relative errors of the six scales."""
    noise_seed: Seed = 0
    """Seed of noise, offsets and scales."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: object) -> object:
        preset = data.get("preset") if isinstance(data, dict) else None
        return {**PRESETS[preset], **data} if isinstance(preset, str) and preset in PRESETS else data  # type: ignore[dict-item]

    def by_channel(self, what: str) -> np.ndarray:
        """(6,) of a key, `gyro_NAME` and `accelerometer_NAME`, such as noise."""
        return np.repeat([getattr(self, f"gyro_{what}"), getattr(self, f"accelerometer_{what}")], 3)

    @property
    def quantum(self) -> np.ndarray:
        """(6,) [rad/s, m/s^2] of a count."""
        return self.by_channel("range") * 2.0 / 2.0**self.bits

    def noise(self, period: float) -> np.ndarray:
        """(6,) [rad/s, m/s^2] standard deviation of a reading, a mean over a period [s], without rounding."""
        return self.by_channel("noise") / math.sqrt(2.0 * period)

    @property
    def mounting(self) -> np.ndarray:
        """(3, 3) R_PS, the sensor's axes in P."""
        return rotation_matrix(np.array(self.rotation))


class SimulatedImu(ImuOptions, key="sensors.imu"):
    """The simulated inertial sensor on the platform; the defaults are those of a BMI088."""

    faults: tuple[ImuFault, ...] = ()
    """Faults of the sensor, applied in order."""

    @property
    def nominal(self) -> ImuOptions:
        """The same without its faults, for the model of a controller."""
        return ImuOptions(**{name: value for name, value in self.given().items() if name != "faults"})


class ImuParams(Record):
    """Parameters of the sensor."""

    mounting: Mat3  # R_PS
    position: Vec3  # [m] in P.
    step: float  # [s] of the plant.
    steps: float  # [steps of the plant] between two readings.
    tick: float  # [steps of the plant] between two ticks of the controller.
    noise: Vec6  # [rad/s, m/s^2] standard deviation of a reading.
    drift: Vec6  # [rad/s, m/s^2] standard deviation of a change of the offset between two readings.
    scale: Vec6  # [-] true scales.
    range: Vec6  # [rad/s, m/s^2] largest reading.
    quantum: Vec6  # [rad/s, m/s^2] of a count.


class ImuState(Record):
    """State of the sensor."""

    imu: Vec6  # [rad/s, m/s^2] The newest reading at the controller's tick; NaN where there is no new one.
    latest: Vec6  # [rad/s, m/s^2] The newest reading.
    offset: Vec6  # [rad/s, m/s^2]
    total: Vec6  # [rad/s, m/s^2] Sum of the true values since the last reading.
    axes: Mat3  # R_BS one step ago.
    velocity: Vec6  # [rad/s, m/s] Angular velocity, and velocity of the place, in B, one step ago.
    place: Vec3  # [m] in B, one step ago.
    base: Vec9  # What the base's inertial unit read one step ago.
    done: float  # Steps.
    fresh: float  # 1 if the controller has not had `latest`.


@njit
def sense(params: ImuParams, normal: Vec12, plant_pose: Vec12, base_motion: Vec12, state: ImuState) -> None:
    """A step of the plant: means of rate and force since the last step, and a reading when one is due."""
    params, state = record(params), record(state)
    turn, axes, twist, arm = np.empty((3, 3)), np.empty((3, 3)), np.empty(6), np.empty(3)
    laws.rotation(plant_pose[:3], turn)
    laws.twist_of(plant_pose[:6], plant_pose[6:], twist)
    laws.turned(turn, params.position[:], arm)
    twist[3] += twist[1] * arm[2] - twist[2] * arm[1]
    twist[4] += twist[2] * arm[0] - twist[0] * arm[2]
    twist[5] += twist[0] * arm[1] - twist[1] * arm[0]
    for i in range(3):
        arm[i] += plant_pose[3 + i]
        for k in range(3):
            axes[i, k] = turn[i, 0] * params.mounting[0, k] + turn[i, 1] * params.mounting[1, k]
            axes[i, k] += turn[i, 2] * params.mounting[2, k]
    first = state.done == 0.0
    if first:
        _keep(axes, twist, arm, base_motion, state)
    # All in the middle of the step; the base's motion in B.
    base, place, velocity, force = np.empty(9), np.empty(3), np.empty(3), np.empty(3)
    for k in range(9):
        base[k] = 0.5 * (base_motion[k] + state.base[k])
    for i in range(3):
        place[i], velocity[i] = 0.5 * (arm[i] + state.place[i]), 0.5 * (twist[3 + i] + state.velocity[3 + i])
        force[i] = base[i] + (twist[3 + i] - state.velocity[3 + i]) / params.step
    add_base_acceleration(base, place, velocity, force)
    for k in range(3):
        rate, along = 0.0, 0.0
        for i in range(3):
            middle = 0.5 * (axes[i, k] + state.axes[i, k])
            rate += middle * (0.5 * (twist[i] + state.velocity[i]) + base[3 + i])
            along += middle * force[i]
        state.total[k] += rate
        state.total[3 + k] += along
    if state.done % params.steps == 0.0:
        count = 1.0 if first else params.steps
        for k in range(6):
            value = params.scale[k] * state.total[k] / count + state.offset[k] + params.noise[k] * normal[k]
            value = np.rint(value / params.quantum[k]) * params.quantum[k]
            state.latest[k] = min(max(value, -params.range[k]), params.range[k])
            state.offset[k] += params.drift[k] * normal[6 + k]
        set_to(state.total[:], 0.0)
        state.fresh = 1.0
    if state.done % params.tick == 0.0:
        for k in range(6):
            state.imu[k] = state.latest[k] if state.fresh > 0.0 else np.nan
        state.fresh = 0.0
    _keep(axes, twist, arm, base_motion, state)
    state.done += 1.0


@njit
def _keep(axes: Mat3, twist: Vec6, place: Vec3, base_motion: Vec12, state: ImuState) -> None:
    """Keeps what the next step needs of this one."""
    for k in range(3):
        copy_to(state.axes[k], axes[k])
    copy_to(state.velocity[:], twist)
    copy_to(state.place[:], place)
    copy_to(state.base[:], base_motion[:9])


def _sense_with_noise(
    params: ImuParams, seed: int, plant_pose: np.ndarray, base_motion: np.ndarray, state: ImuState
) -> None:
    done, steps = state["done"][0], params["steps"][0]
    due = done % steps == 0.0
    normal = tick_numbers(seed, _STREAM, int(done // steps), 12, normal=True) if due else _NO_NOISE
    sense(params, normal, plant_pose, base_motion, state)


_NO_NOISE = np.zeros(12)


def imu_part(options: ImuOptions, gravity: Gravity, step: float, period: float) -> Part:
    """`plant_pose` (12,), `base_motion` (12,) in steps [s] of the plant -> `imu` (6,) for a controller's period [s].

    Gravity, in m/s^2, a number along -z or a vector in B, is read where `base_motion` is no signal. Raises a
    ConfigurationError where a period is no multiple of the step.
    """
    every = options.period or period
    normal = tick_numbers(options.noise_seed, _UNIT_STREAM, 0, 12, normal=True)
    params = ImuParams.new(
        mounting=options.mounting,
        position=options.position,
        step=on_grid(step),
        steps=steps_per("sensors.imu.period", every, step, "plant.time_step"),
        tick=steps_per("estimator.period", period, step, "plant.time_step"),
        noise=options.noise(every),
        drift=options.by_channel("drift") * math.sqrt(every),
        scale=1.0 + options.scale_error * normal[6:],
        range=options.by_channel("range"),
        quantum=options.quantum,
    )
    first = ImuState.new(offset=options.by_channel("bias") * normal[:6], imu=np.nan)
    parameters, inputs = {"params": params}, {"plant_pose": 12, "base_motion": 12}
    part = Part("imu", _sense_with_noise, {"seed": options.noise_seed}, inputs, ("imu",), first, parameters=parameters)
    at_rest = np.append(base_reading(gravity), np.zeros(3))
    return part._replace(period=step).connected(base_motion=at_rest)


def imu_parts(
    options: SimulatedImu, gravity: Gravity, step: float, period: float, first: Mapping[str, np.ndarray]
) -> list[Part]:
    """`imu_part`, behind the delay of its readings, with its faults.

    `first` has the first `plant_pose` (12,), and that of `base_motion` (12,) if there is one.
    """
    part, late = imu_part(options, gravity, step, period), round(options.delay / step)
    delays, sources = list[Part](), {name: name for name in first}
    for name, value in first.items() if late > 0 else ():
        sources[name] = f"imu_{name}"
        delay = delay_part(late, value, f"imu_{name}_delay")._replace(period=step)
        delays.append(delay.connected(value=name).named(value=sources[name]))
    part = part.connected(**sources)
    if not options.faults:
        return [*delays, part]
    faulty = faulty_sensor_part(options.faults, 6, period)._replace(name="faulty_imu", period=period)
    return [*delays, part.named(imu="true_imu"), faulty.connected(reading="true_imu").named(reading="imu")]
