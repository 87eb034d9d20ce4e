"""A ball in Drake's plant of the robot: a sphere and a plate that touch at a point, with dry friction."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import AddContactMaterial, Cylinder, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import CoulombFriction, ExternallyAppliedSpatialForce
from pydrake.multibody.tree import QuaternionFloatingJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.mechanics.rolling_ball import SLOW
from stewart_drake.robot.gravity import gravity_vector

if TYPE_CHECKING:
    from stewart_drake.plant.multibody_plant import StewartRobot

THICKNESS = 0.01  # [m] of the plate.
DENT = 1e-5  # [m] by which a ball at rest dents the plate; smaller ones make no difference to its path.
_BLUE, _GREY = np.array([0.2, 0.4, 0.8, 1.0]), np.array([0.7, 0.7, 0.7, 0.5])


class BallBody:
    """A ball on a robot in a `MultibodyPlant` that is registered with a SceneGraph; before it is finalised.

    Attributes:
        options: The ball.
    """

    def __init__(self, robot: StewartRobot, options: BallOptions) -> None:
        self._plant, self.options, self._base = robot.plant, options, robot.base.rotation().matrix()
        self._gravity = gravity_vector(robot.gravity)
        if not robot.plant.geometry_source_is_registered():
            raise ConfigurationError("plant", "one without a SceneGraph", "one that is registered with one, for a ball")
        with drake_guard("adding the ball"):
            self._add(robot)

    def _add(self, robot: StewartRobot) -> None:
        """The bodies with their contact; the robot's plate is a part of its platform."""
        plant, options = self._plant, self.options
        size, plate = options.radius, options.plate
        inertia = SpatialInertia(
            options.mass, np.zeros(3), UnitInertia.TriaxiallySymmetric(options.inertia / options.mass)
        )
        self._body = plant.AddRigidBody("ball", robot.instance, inertia)
        joint = QuaternionFloatingJoint("ball", robot.frame("base"), self._body.body_frame())
        self._joint = plant.AddJoint(joint)
        material = ProximityProperties()
        friction = CoulombFriction(options.friction, options.friction)
        stiffness = 2.0 * options.mass * float(np.linalg.norm(self._gravity)) / DENT  # Of two surfaces in series.
        AddContactMaterial(None, stiffness, friction, material)
        material.AddProperty("material", "relaxation_time", plant.time_step())
        self._platform = plant.GetBodyByName("platform", robot.instance)
        at = RigidTransform([0.0, 0.0, plate.height - 0.5 * THICKNESS])
        for body, place, shape, name, colour in (
            (self._body, RigidTransform(), Sphere(size), "ball", _BLUE),
            (self._platform, at, Cylinder(plate.radius, THICKNESS), "plate", _GREY),
        ):
            plant.RegisterCollisionGeometry(body, place, shape, f"{name}_collision", material)
            plant.RegisterVisualGeometry(body, place, shape, f"{name}_visual", colour)

    @cached_property
    def indices(self) -> np.ndarray:
        """(13,) indices of its quaternion, place, angular and linear velocity, in B, in a state of the plant."""
        first, rate = self._joint.position_start(), self._plant.num_positions() + self._joint.velocity_start()
        return np.concatenate([first + np.arange(7), rate + np.arange(6)])

    def at_start(self, robot: StewartRobot, state: np.ndarray) -> np.ndarray:
        """States (..., nq + nv) of the plant, with the ball put where it starts, and rolling."""
        (pose, _), twist, radius = robot.pose_and_rate(state), state[..., robot.indices.twist], self.options.radius
        turn = rotation_matrix(pose[..., :3])
        place = turn @ np.array([*self.options.start, self.options.plate.height + radius])
        slide, normal = turn @ np.array([*self.options.velocity, 0.0]), turn[..., 2]
        omega = twist[..., :3] - normal * np.sum(normal * twist[..., :3], axis=-1, keepdims=True)
        velocity = twist[..., 3:] + np.cross(twist[..., :3], place) + slide
        upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*pose.shape[:-1], 4))
        parts = upright, pose[..., 3:] + place, omega + np.cross(normal, slide) / radius, velocity
        state[..., self.indices] = np.concatenate(parts, axis=-1)
        return state

    def motion(self, robot: StewartRobot, state: np.ndarray) -> np.ndarray:
        """x, y [m] on the plate, their rates, and spin (..., 5) in states, see `plant_options.BALL`."""
        (pose, _), twist, ball = robot.pose_and_rate(state), state[..., robot.indices.twist], state[..., self.indices]
        turn, arm = rotation_matrix(pose[..., :3]), ball[..., 4:7] - pose[..., 3:]
        velocity = ball[..., 10:] - twist[..., 3:] - np.cross(twist[..., :3], arm)
        place, rate, spin = (
            (np.swapaxes(turn, -1, -2) @ vector[..., None])[..., 0] for vector in (arm, velocity, ball[..., 7:10])
        )
        return np.concatenate([place[..., :2], rate[..., :2], spin[..., 2:]], axis=-1)

    def forces(self, robot: StewartRobot, state: np.ndarray, push: np.ndarray) -> list[ExternallyAppliedSpatialForce]:
        """A push (2,) [N] along the plate's axes, and rolling resistance, in a state."""
        turn = rotation_matrix(robot.pose_and_rate(state)[0][:3])
        slide, weight = turn[:, :2] @ self.motion(robot, state)[2:4], -self.options.mass * self._gravity @ turn[:, 2]
        drag = self.options.resistance * max(0.0, weight) / np.hypot(np.linalg.norm(slide), SLOW)
        couple = -drag * self.options.radius * np.cross(turn[:, 2], slide)
        result = []
        for body, moment, force in (
            (self._body, couple, turn[:, :2] @ push),
            (self._platform, -couple, np.zeros(3)),
        ):
            applied = ExternallyAppliedSpatialForce()
            applied.body_index, applied.p_BoBq_B = body.index(), np.zeros(3)
            applied.F_Bq_W = SpatialForce(tau=self._base @ moment, f=self._base @ force)
            result.append(applied)
        return result


class BallForces(LeafSystem):
    """`BallBody.forces` of the ball on a robot.

    Ports:
        plant_state: in (nq + nv,), the state of the plant.
        ball_push: in (2,) [N], along the plate's axes.
        spatial_force: out, for the plant's port `applied_spatial_force`.
    """

    def __init__(self, robot: StewartRobot) -> None:
        super().__init__()
        assert robot.ball is not None
        self._robot, self._ball = robot, robot.ball
        self.plant_state = self.DeclareVectorInputPort("plant_state", robot.size)
        self.ball_push = self.DeclareVectorInputPort("ball_push", 2)
        forces = Value[list[ExternallyAppliedSpatialForce]]
        self.spatial_force = self.DeclareAbstractOutputPort("spatial_force", lambda: forces(), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        state, push = self.plant_state.Eval(context), self.ball_push.Eval(context)
        output.set_value(self._ball.forces(self._robot, state, push))
