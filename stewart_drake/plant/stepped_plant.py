"""Drake's plant of the robot for a loop that is not a Diagram."""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, FixedInputPortValue

from stewart_drake.base.errors import drake_guard
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.plant.base_forces import base_forces
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import DrakeOptions, foreign_state
from stewart_drake.robot import Gravity, RobotParameters


class SteppedPlant:
    """The `MultibodyPlant` as a `Plant`."""

    def __init__(
        self, robot: RobotParameters, options: DrakeOptions, gravity: Gravity, ball: BallOptions | None = None
    ) -> None:
        self._diagram, self._stewart = build_plant(robot, options, gravity, ball=ball)
        self._ball_force = np.zeros(2)
        plant = self._stewart.plant
        self._force_port, self._period = plant.get_applied_spatial_force_input_port(), plant.time_step()
        self._begin()

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Begins at a pose (6,) and its rate (6,), with relaxed bristles and no broken rod."""
        self._begin()
        self._stewart.set_state(self._context, pose, pose_rate)
        return self._measure()

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        with drake_guard("a step of the plant"):
            self._torque.GetMutableData().get_mutable_value().SetFromVector(torque)
            if self._stewart.ball is not None or (wrench != self._wrench).any():
                self._push(wrench)
            self._steps += 1
            self._simulator.AdvanceTo(self._steps * self._period)
        return self._measure()

    def set_base(self, base: np.ndarray) -> None:
        forces = base_forces(self._stewart, self._plant_context, base)
        self._force_port.FixValue(self._plant_context, [self._stewart.push(self._wrench), *forces])

    def push_ball(self, force: np.ndarray) -> None:
        self._ball_force = force.copy()

    def save(self) -> tuple[int, list[np.ndarray]]:
        """Steps done, and the discrete state of the Diagram: of the plant, and of its friction if it has any."""
        state = self._context.get_discrete_state()
        return self._steps, [np.array(state.get_vector(k).value()) for k in range(state.num_groups())]

    def restore(self, state: tuple[int, list[np.ndarray]]) -> np.ndarray:
        sizes = [len(group) for group in self.save()[1]]
        if not isinstance(state, tuple) or [len(group) for group in state[1]][:1] != sizes[:1]:
            raise foreign_state(state, f"a MultibodyPlant with {sizes[0]} numbers")
        self._begin()
        self._steps, groups = state
        with drake_guard("going on from a state"):
            self._context.SetTime(self._steps * self._period)
            self._simulator.Initialize()
            self._stewart.put(self._context, groups[0])
            # Bristles that were not saved begin relaxed.
            for k, values in enumerate(groups[: len(sizes)]):
                self._context.SetDiscreteState(k, values)
        return self._measure()

    def _begin(self) -> None:
        self._simulator, self._steps = Simulator(self._diagram), 0
        self._context: Context = self._simulator.get_mutable_context()
        self._plant_context = self._stewart.plant.GetMyMutableContextFromRoot(self._context)
        self._torque: FixedInputPortValue = self._diagram.GetInputPort("torque").FixValue(self._context, np.zeros(6))
        self._push(np.zeros(6))

    def _push(self, wrench: np.ndarray) -> None:
        self._wrench, forces = wrench.copy(), [self._stewart.push(wrench)]
        if self._stewart.ball is not None:
            state = self._stewart.plant.GetPositionsAndVelocities(self._plant_context)
            forces += self._stewart.ball.forces(self._stewart, state, self._ball_force)
        self._force_port.FixValue(self._plant_context, forces)

    def _measure(self) -> np.ndarray:
        return self._stewart.measure(self._stewart.plant.GetPositionsAndVelocities(self._plant_context))
