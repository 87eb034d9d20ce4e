"""The robot as a continuous System, for Drake's integrators, its linearisations and AutoDiff."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.framework import BasicVector, BasicVector_, Context, ContinuousState, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from stewart_drake.base.arguments import checked
from stewart_drake.base.config import Vector6, check_value
from stewart_drake.base.errors import ConfigurationError, NotFiniteError, SingularPoseError, drake_guard
from stewart_drake.hardware.motors import within_limit
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.mechanics.kinematics_laws import Legs
from stewart_drake.mechanics.linear_algebra import derivatives
from stewart_drake.plant.closed_form import ClosedFormOptions, crank_motion, motion_rate
from stewart_drake.plant.context_parameters import WithParameters
from stewart_drake.plant.model_files import home_frames
from stewart_drake.plant.plant_options import MechanismOptions
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import Gravity, base_reading, check_gravity


def _evaluate(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    """A function of numbers or of AutoDiffXd, the latter by central differences."""
    if at.dtype != object:
        return np.asarray(function(at))
    value, slope = derivatives(function, ExtractValue(at).ravel())
    return np.asarray(InitializeAutoDiff(value, slope @ ExtractGradient(at))).ravel()


def _of_scalar(T: Any) -> Any:  # noqa: N803 - Drake's name
    base: Any = LeafSystem_[T]

    class Impl(base, WithParameters):
        """The closed form of the robot, a continuous plant of 12 states; `ClosedFormPlant(robot, options, gravity)`.

        Of `ClosedFormOptions` it uses payload and viscous friction; stiction is refused. gravity is in [m/s^2], see
        `robot.gravity`. It begins at home at rest; pitch stays away from +-pi/2. Derivatives with respect to AutoDiffXd
        are central differences.

        Its numeric parameters are `robot`, a record with the payload, of which masses and inertias may be changed,
        `friction` and `gravity` (1,) or (3,) as it was given.

        Ports:
            torque: in (6,) [N m], of the motors; limited to their effort limit.
            wrench: in (6,) [N m, N], moment about P and force, in B; zero if not connected.
            base: in (9,), motion of the base, see `robot.gravity.base_reading`; gravity and rest if not connected.
            measurement: out (12,), pose [rad, m], pose rate [rad/s, m/s] (Euler rates); the state.
            crank_state: out (12,), angles of the cranks [rad] from the horizontal, within half a turn of home, then
                their rates [rad/s].
        """

        @checked
        def _construct(
            self,
            robot: RobotParameters,
            options: MechanismOptions | None = None,
            gravity: Gravity = STANDARD_GRAVITY,
            *,
            converter: Any = None,
        ) -> None:
            base.__init__(self, converter=converter)
            options = ClosedFormOptions() if options is None else options
            check_gravity(gravity)
            friction = options.friction_of(robot)
            if friction["break_away"].any():
                raise ConfigurationError("friction", "motors that stick", "viscous friction alone, in continuous time")
            self._arguments, self._home = (robot, options, gravity), home_frames(robot)
            vector = np.atleast_1d(np.asarray(gravity, dtype=float))
            numbers = {"robot": options.loaded(robot), "friction": friction, "gravity": vector}
            self._numbers = self.declare_parameters(numbers, BasicVector_[T])
            self.torque = self.DeclareVectorInputPort("torque", 6)
            self.wrench = self.DeclareVectorInputPort("wrench", 6)
            self.base = self.DeclareVectorInputPort("base", 9)
            home = BasicVector_[T](np.append(robot.home_pose, np.zeros(6)))
            self.measurement = self.DeclareStateOutputPort("measurement", self.DeclareContinuousState(home, 6, 6, 0))
            needs = {self.xc_ticket()}
            self.crank_state = self.DeclareVectorOutputPort(
                "crank_state", 12, self._cranks, prerequisites_of_calc=needs
            )
            # The same as in `StewartRobot`.
            self.torque_input_port, self.state_output_port = self.torque, self.measurement

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, *other._arguments, converter=converter)

        def set_state(self, context: Context, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
            """Sets pose (6,) [rad, m] and pose rate (6,); `context` of the Diagram."""
            pose, rate = np.asarray(pose), np.zeros(6) if pose_rate is None else np.asarray(pose_rate)
            check_value("pose", pose, Vector6)
            check_value("pose_rate", rate, Vector6)
            leg_geometry(self._arguments[0], pose)  # Raises out of reach.
            with drake_guard("setting the plant's state"):
                mine = self.GetMyMutableContextFromRoot(context)
                self.ValidateContext(mine)
            mine.SetContinuousState(np.append(pose, rate))

        def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:  # noqa: N802 - Drake's name
            state = context.get_continuous_state_vector().CopyToVector()
            wrench = self.wrench.Eval(context) if self.wrench.HasValue(context) else np.zeros(6)
            self.read_parameters(context)
            gravity = self._numbers["gravity"]
            still = base_reading(gravity if len(gravity) == 3 else float(gravity[0]))
            base = self.base.Eval(context) if self.base.HasValue(context) else still
            rate = _evaluate(self._rate, np.concatenate([state, self.torque.Eval(context), wrench, base]))
            derivatives.get_mutable_vector().SetFromVector(rate)

        def _rate(self, values: np.ndarray) -> np.ndarray:
            motion, torque, wrench, base = values[:12], values[12:18], values[18:24], values[24:]
            if not np.isfinite(motion[:6]).all():
                raise NotFiniteError("the plant's pose", motion[:6].copy())
            robot, friction = self._numbers["robot"], self._numbers["friction"]
            torque, result = within_limit(torque, robot["effort_limit"][0]), np.empty(12)
            leg, margin = motion_rate(robot, friction, base, Legs.empty(), motion, torque, wrench, result)
            if leg >= 0:
                raise SingularPoseError("serial", motion[:6].copy(), margin, 0.0, leg)
            if not np.isfinite(result).all():
                raise NotFiniteError("the plant's acceleration", result[6:])
            return result

        def _cranks(self, context: Context, output: BasicVector) -> None:
            def cranks(state: np.ndarray) -> np.ndarray:
                return np.concatenate(crank_motion(self._arguments[0], self._home, state[:6], state[6:]))

            output.SetFromVector(_evaluate(cranks, context.get_continuous_state_vector().CopyToVector()))

    return Impl


ClosedFormPlant_: Any = TemplateSystem.define("ClosedFormPlant_", T_list=[float, AutoDiffXd])(_of_scalar)
ClosedFormPlant: Any = ClosedFormPlant_[None]
