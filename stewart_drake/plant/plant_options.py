"""Interface and options of plants, and users' plants; this file does not import Drake."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import Field

from stewart_drake.base.code import CodePath, UserCode
from stewart_drake.base.config import Flag, InOtherKinds, LegNumber, NotNegative, Real, Section
from stewart_drake.base.errors import ConfigurationError, NotFiniteError
from stewart_drake.base.families import UserMade, imported
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.friction import Friction, FrictionOptions, bristle_stiffness
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.leg import LARGEST_SIZE, Moderate

MIN_TIME_STEP, MAX_TIME_STEP = 1e-6, 0.01  # [s] limited by rounding, and by the motion.
POSE, RATE, ANGLES, CRANK_RATES = (slice(start, start + 6) for start in range(0, 24, 6))
"""Places in the measurement (24,) of a plant: pose [rad, m], its rate, angles of the cranks [rad], their rates."""
BALL = slice(24, 29)
"""Place of a ball in a measurement, which then has (29,): x, y [m] on the plate, their rates, spin [rad/s]."""

RodJoint = Literal["universal", "ball"]
"""Joint between crank and rod. `ball` is the paper's topology; rods then spin freely about their axes."""
Place = Annotated[Real, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)]


class Plant(Protocol):
    """A simulated robot. Its motion is a measurement (24,), see `POSE` and `BALL`, valid until the next call."""

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Starts at a pose (6,) [rad, m] with a rate (6,) [rad/s, m/s]."""

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Moves by one step under torques (6,) [N m] of the motors and a wrench (6,) [N m, N] about P."""

    def set_base(self, base: np.ndarray) -> None:
        """Sets the motion of the base until the next call: (9,), see `robot.gravity.base_reading`."""

    def save(self) -> object:
        """A copy of the state, for `restore` of a plant of the same kind."""

    def restore(self, state: Any) -> np.ndarray:
        """Sets a saved state; raises a ConfigurationError for one of another kind of plant."""


class BallPlant(Plant, Protocol):
    """A simulated robot with a ball on it."""

    def push_ball(self, force: np.ndarray) -> None:
        """Sets the force (2,) [N] on the ball until the next call, along the plate's axes."""


def foreign_state(state: object, expected: str) -> ConfigurationError:
    """The error of `restore` for a state of another kind of plant."""
    return ConfigurationError("state of a plant", getattr(state, "shape", type(state).__name__), f"that of {expected}")


Simulated = tuple[dict[str, object], list[tuple[str, object, str]]]  # See `PlantOptions.simulated`.


class PlantOptions(Section, ABC, key="plant"):
    """Base of the options of plants."""

    in_diagram: ClassVar[bool] = False
    """Whether Drake's Simulator runs it in a Diagram; otherwise the loop steps it as a `Plant`."""
    compared_with: ClassVar[str | None] = None
    """The kind that it replaces for speed; studies repeat one of their runs with that kind."""
    base_moves: ClassVar[bool] = True
    """Whether its base may move."""
    carries_ball: ClassVar[bool] = False
    """Whether a ball can roll on its platform."""
    joints_rub: ClassVar[bool] = False
    """Whether it can have friction in the rods' ball joints."""
    moved_keys: ClassVar[dict[str, str]] = {"engine": "plant.kind: drake, closed_form or module:Class"}

    kind: str
    """Kind of plant."""
    time_step: Annotated[Real, Field(ge=MIN_TIME_STEP, le=MAX_TIME_STEP)] = 0.001
    """[s] time step of the plant."""
    payload_mass = InOtherKinds(0.0)
    """[kg] on the platform that neither `robot` nor the controller knows."""
    rod_joint = InOtherKinds("universal")
    """Joint between crank and rod, of pictures and files."""
    universal_damping = InOtherKinds(0.0)
    """[N m s/rad] of that joint."""

    @abstractmethod
    def make(self, robot: RobotParameters, gravity: Gravity) -> Plant:
        """The plant, to be stepped; gravity in [m/s^2] in B, with a base at rest."""

    @property
    def code(self) -> CodePath | None:
        """The user's code that it runs; None for a kind of the package."""
        return None

    def loaded(self, robot: RobotParameters) -> laws.Robot:
        """The robot with its payload as a part of the platform."""
        return laws.robot_record(robot)

    def simulated(self, robot: RobotParameters) -> Simulated:  # noqa: ARG002
        """For reports: keys of `robot` for which the plant has other values; further facts: name, value, unit."""
        return {}, []

    @property
    def friction_options(self) -> FrictionOptions:
        """Friction of the motors, given by whichever keys."""
        return FrictionOptions()

    def friction_of(self, robot: RobotParameters) -> Friction:
        """The friction of a robot's motors."""
        step = self.time_step
        return self.friction_options.record(bristle_stiffness(robot.crank_axis_inertias, step), step)


class MechanismOptions(PlantOptions):
    """Options of plants that simulate the robot's mechanism: friction of its motors, and a payload."""

    motor_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of the motors; implicit, stable at any step. Short for `friction.viscous`."""
    motor_friction: Moderate = 0.0
    """[N m] dry (Coulomb) friction of the motors, the same at rest and in motion. Short for `friction.coulomb`."""
    friction: FrictionOptions | None = None
    """Friction of the motors with stiction, motor by motor; null takes `motor_damping` and `motor_friction`."""
    payload_mass: Moderate = 0.0
    """[kg] point mass on the platform of the plant only; neither `robot` nor the controller knows it."""
    payload_position: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)
    """[m] position of the payload in the platform's frame P."""

    def rules(self) -> None:
        for name in ("motor_friction", "motor_damping"):
            if self.friction is not None and getattr(self, name) > 0.0:
                raise ConfigurationError(name, getattr(self, name), "0, because `friction` is given and has this value")

    def braked(self, robot: RobotParameters) -> Self:
        """The same with brakes that hold the cranks with the motors' effort limits."""
        friction = FrictionOptions(coulomb=tuple(robot.effort_limits.tolist()))
        short = {name: self.__pydantic_fields__[name].default for name in ("motor_friction", "motor_damping")}
        return self.replace(**short, friction=friction)

    @property
    def friction_options(self) -> FrictionOptions:
        short = {"coulomb": self.motor_friction, "viscous": self.motor_damping}
        return FrictionOptions.from_dict(short) if self.friction is None else self.friction

    def loaded(self, robot: RobotParameters) -> laws.Robot:
        return laws.with_payload(laws.robot_record(robot), self.payload_mass, np.array(self.payload_position))


# --- Drake's ---


class BrokenRod(Section, key="plant.broken_rod"):
    """A rod that comes off the platform and hangs from its crank."""

    leg: LegNumber
    """Number of the leg, 0 to 5."""
    time: NotNegative
    """[s] when the rod breaks."""


class DrakeOptions(MechanismOptions):
    """Drake's MultibodyPlant: 14 bodies, loops closed by constraints; it runs in a Diagram."""

    in_diagram: ClassVar[bool] = True
    carries_ball: ClassVar[bool] = True

    kind: Literal["drake"] = "drake"
    rod_joint: RodJoint = "universal"
    """Joint between crank and rod; `ball` is the paper's and leaves the rods' six spins uncontrolled."""
    collision: Flag = False
    """Whether cranks, rods, platform and base collide; bodies connected by a joint never do."""
    universal_damping: Moderate = 0.0
    """[N m s/rad] viscous friction about the axes of the joints between crank and rod; implicit."""
    platform_joint_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of the ball joints between rods and platform; explicit, see
    `platform_damping_limit`. It is isotropic only near home: at 45 deg of swing it is 0.6 to 3.4 times as large, by
    direction."""
    broken_rod: BrokenRod | None = None
    """A rod that breaks during the run; null for none."""

    @property
    def break_step(self) -> int | None:
        """The first step that begins when the rod breaks, or later; None if none breaks."""
        steps = math.inf if self.broken_rod is None else self.broken_rod.time / self.time_step
        return math.ceil(steps - 1e-6) if math.isfinite(steps) else None

    def make(self, robot: RobotParameters, gravity: Gravity, ball: BallOptions | None = None) -> Plant:
        # Imported here: it imports these options, and Drake, which takes seconds.
        plant: Plant = imported("plant.stepped_plant:SteppedPlant")(robot, self, gravity, ball)
        return plant


def platform_damping_limit(robot: RobotParameters, options: DrakeOptions) -> float:
    """Largest `platform_joint_damping` d [N m s/rad] for its explicit integration.

    A ball that turns at w dissipates d w^2, and w^2 <= 2 (w_rod^2 + w_platform^2): no motion decays faster than d
    max(2 / I_rod, 12 / I_platform). The limit makes that 1 / time_step, half of the stability limit. I_rod is small
    about the axis of a rod that spins between two balls.
    """
    rod_inertia = min(robot.rod_inertia) if options.rod_joint == "ball" else robot.rod_inertia[0]
    fastest = max(2.0 / rod_inertia, 12.0 / robot.smallest_platform_inertia)
    return 1.0 / (options.time_step * fastest)


# --- users' plants ---


class UserPlantOptions(UserMade, PlantOptions, key="plant"):  # type: ignore[misc]
    """A user's plant: `initial(pose, pose_rate)` starts it, `step(torque, wrench)` moves it by one time step.

    Both return pose (6,) [rad, m] and pose rate (6,) [rad/s, m/s] of the platform; the motion of the cranks follows
    from the robot's geometry. They may also return the cranks' angles [rad] and rates [rad/s]. torque (6,) is that of
    the motors [N m], wrench (6,) the external one about P [N m, N]. A constructor that names `robot`, `gravity` or
    `time_step` gets them.
    """

    base_moves: ClassVar[bool] = False
    asked = "step(torque, wrench) returns pose and pose rate, or these, crank angles and crank rates, (6,) each"

    def make(self, robot: RobotParameters, gravity: Gravity) -> Plant:
        plant = self.new_object({"robot": robot, "gravity": gravity, "time_step": self.time_step})
        for method in ("initial", "step"):
            if not callable(getattr(plant, method, None)):
                raise self.refusal(f"one without {method}")
        return _UserPlant(self, robot, plant)


class _UserPlant:
    """A user's object as a `Plant`; its attributes are its state."""

    def __init__(self, options: UserPlantOptions, robot: RobotParameters, plant: Any) -> None:
        self._options, self._robot, self._plant = options, robot, plant
        self._guard, self._measured = UserCode(type(plant).__module__), np.empty(24)

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        return self._ask(self._plant.initial, pose, pose_rate)

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        return self._ask(self._plant.step, torque, wrench)

    def set_base(self, base: np.ndarray) -> None:
        raise ConfigurationError("base.motion", base, "null, with a plant of yours")

    def save(self) -> object:
        return type(self._plant), copy.deepcopy(vars(self._plant)), self._measured.copy()

    def restore(self, state: object) -> np.ndarray:
        if not isinstance(state, tuple) or state[0] is not type(self._plant):
            raise foreign_state(state, f"another {type(self._plant).__name__}")
        _, attributes, measured = copy.deepcopy(state)
        vars(self._plant).update(attributes)
        self._measured[:] = measured
        return self._measured

    def _ask(self, method: Callable[..., object], *arguments: np.ndarray) -> np.ndarray:
        with self._guard:
            # Copies, which the method may keep or change.
            result = method(*(vector.copy() for vector in arguments))
        parts = [self._options.numbers(part) for part in result] if np.iterable(result) else []
        if [part.shape for part in parts] not in ([(6,)] * 2, [(6,)] * 4):
            raise self._options.refusal(", ".join(str(part.shape) for part in parts) or f"a {type(result).__name__}")
        if not all(np.isfinite(part).all() for part in parts):
            raise NotFiniteError(f"what {self._options.code.name} returned", np.concatenate(parts))
        if len(parts) == 2:
            pose, rate = parts
            geometry = leg_geometry(self._robot, pose)
            parts += [inverse_kinematics(self._robot, pose), crank_rates(self._robot, geometry, pose, rate)]
        np.concatenate(parts, out=self._measured)
        return self._measured
