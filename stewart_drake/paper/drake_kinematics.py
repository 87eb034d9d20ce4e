"""Kinematics by Drake's `MultibodyPlant`: the other side of the comparison with the closed form and Newton's method."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.solvers import SnoptSolver, SolverOptions

from stewart_drake.errors import drake_guard
from stewart_drake.leg import LEGS
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.robot import RobotParameters

Given = Literal["pose", "cranks"]
GIVEN: tuple[Given, ...] = get_args(Given)
_TOLERANCE = 1e-8
"""[m] asked of the loop closures in `DrakeKinematics.solve`. SNOPT's own 1e-6 would hide what is compared; at 1e-10 it
says of one solution in ten that it cannot be improved, and counts it as none."""


class DrakeKinematics:
    """One robot's plant, asked for positions only.

    Attributes:
        robot: Geometry; its branch is that of the plant.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self.robot = robot
        _, self._stewart = build_plant(robot)
        self._plant, self._indices = self._stewart.plant, self._stewart.indices
        self._context = self._plant.CreateDefaultContext()
        self._home_angles = inverse_kinematics(robot, robot.home_pose)

    def rod_spans(self, pose: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Distances of crank tips to platform joints that Drake's forward kinematics gives.

        Crank angles and pose are set each for itself; nothing of the package's kinematics is in between.

        Args:
            pose: (n, 6) [rad, m].
            theta: (n, 6) [rad] crank angles.

        Returns:
            (n, 6) [m]; the length of the rods where `theta` belongs to `pose`.
        """
        spans = np.empty(theta.shape)
        tips = np.outer(self.robot.crank_lengths, [1.0, 0.0, 0.0])
        for row, (at, angles) in enumerate(zip(pose, theta, strict=True)):
            self._set(self._positions(at, angles))
            ends = self._joints() - self._points("crank", tips)
            spans[row] = np.linalg.norm(ends, axis=-1)
        return spans

    def loop_gaps(self, pose: np.ndarray) -> np.ndarray:
        """Distances of rod ends to platform joints in the plant's assembled state, by Drake; (n, 6) [m]."""
        gaps = np.empty(pose.shape)
        ends = np.outer(self.robot.rod_lengths, [0.0, 0.0, 1.0])
        for row, state in enumerate(self._stewart.assemble(pose)):
            self._set(state[: self._plant.num_positions()])
            gaps[row] = np.linalg.norm(self._points("rod", ends) - self._joints(), axis=-1)
        return gaps

    def solve(self, given: Given, pose: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        """Drake's `InverseKinematics` with the six ball constraints, started from the robot assembled elsewhere.

        Args:
            given: What is held: the platform's `pose`, or the `cranks` at the angles of that pose.
            pose: (6,) [rad, m].
            start: (6,) [rad, m] pose of the initial guess, on the same branch.

        Returns:
            (6,) the crank angles [rad] where the pose is given, the pose [rad, m] where the cranks are; None where the
            solver finds none.
        """
        index = self._indices
        positions = self._positions(pose, inverse_kinematics(self.robot, pose))
        held = index.crank if given == "cranks" else np.concatenate([index.quaternion, index.position])
        guess = self._stewart.assemble(start)[: self._plant.num_positions()]
        guess[held] = positions[held]
        with drake_guard("inverse kinematics"):
            problem = InverseKinematics(self._plant)
            program, q = problem.prog(), problem.q()
            program.AddBoundingBoxConstraint(positions[held], positions[held], q[held])
            program.SetInitialGuess(q, guess)
            options = SolverOptions()
            options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", _TOLERANCE)
            result = SnoptSolver().Solve(program, None, options)
        if not result.is_success():
            return None
        state = np.concatenate([result.GetSolution(q), np.zeros(self._plant.num_velocities())])
        if given == "pose":
            return self._stewart.crank_angles(state)
        return self._stewart.pose_and_rate(state)[0]

    def _positions(self, pose: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Positions of the plant, its rods as at home."""
        positions = np.zeros(self._plant.num_positions())
        positions[self._indices.crank] = theta - self._home_angles
        positions[self._indices.quaternion] = RollPitchYaw(pose[:3]).ToQuaternion().wxyz()
        positions[self._indices.position] = pose[3:]
        return positions

    def _set(self, positions: np.ndarray) -> None:
        with drake_guard("setting positions"):
            self._plant.SetPositions(self._context, positions)

    def _points(self, body: str, points: np.ndarray) -> np.ndarray:
        """(6, 3) [m] a point (6, 3) of each leg's body, in B."""
        plant, world = self._plant, self._plant.world_frame()
        frames = [plant.GetFrameByName(f"{body}_{leg}") for leg in range(LEGS)]
        at = zip(frames, points, strict=True)
        return np.array([plant.CalcPointsPositions(self._context, frame, point, world)[:, 0] for frame, point in at])

    def _joints(self) -> np.ndarray:
        """(6, 3) [m] platform joints in B."""
        platform = self._plant.GetFrameByName("platform")
        points = self._plant.CalcPointsPositions(
            self._context, platform, self.robot.platform_joints.T, self._plant.world_frame()
        )
        return np.asarray(points).T
