"""A ball in Drake's plant of the robot: a sphere and a plate that touch at a point, with dry friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import AddContactMaterial, Cylinder, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import CoulombFriction, ExternallyAppliedSpatialForce
from pydrake.multibody.tree import QuaternionFloatingJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.base.errors import ConfigurationError
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
        plant, self.options, self._base = robot.plant, options, robot.base.rotation().matrix()
        self._gravity = gravity_vector(robot.gravity)
        if not plant.geometry_source_is_registered():
            raise ConfigurationError("plant", "one without a SceneGraph", "one that is registered with one, for a ball")
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

    def indices(self, positions: int) -> np.ndarray:
        """(13,) indices of quaternion, place, angular and linear velocity, in B, in a state with so many positions."""
        first, rate = self._joint.position_start(), positions + self._joint.velocity_start()
        return np.concatenate([first + np.arange(7), rate + np.arange(6)])

    def at_start(self, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Its part (..., 13) of a state, where it starts and rolls, for poses and twists (..., 6) of the platform."""
        turn, radius = rotation_matrix(pose[..., :3]), self.options.radius
        place = turn @ np.array([*self.options.start, self.options.plate.height + radius])
        slide, normal = turn @ np.array([*self.options.velocity, 0.0]), turn[..., 2]
        omega = twist[..., :3] - normal * np.sum(normal * twist[..., :3], axis=-1, keepdims=True)
        velocity = twist[..., 3:] + np.cross(twist[..., :3], place) + slide
        upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*pose.shape[:-1], 4))
        return np.concatenate(
            [upright, pose[..., 3:] + place, omega + np.cross(normal, slide) / radius, velocity], axis=-1
        )

    def measure(self, ball: np.ndarray, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """x, y on the plate, their rates, spin (..., 5), from its part (..., 13) of states and the platform motion."""
        turn, arm = rotation_matrix(pose[..., :3]), ball[..., 4:7] - pose[..., 3:]
        velocity = ball[..., 10:] - twist[..., 3:] - np.cross(twist[..., :3], arm)
        place, rate, spin = (
            (np.swapaxes(turn, -1, -2) @ vector[..., None])[..., 0] for vector in (arm, velocity, ball[..., 7:10])
        )
        return np.concatenate([place[..., :2], rate[..., :2], spin[..., 2:]], axis=-1)

    def forces(self, motion: np.ndarray, pose: np.ndarray, push: np.ndarray) -> list[ExternallyAppliedSpatialForce]:
        """A push (2,) [N] along the plate's axes, and rolling resistance, for a motion (5,) of `measure` at a pose."""
        turn = rotation_matrix(pose[:3])
        slide, weight = turn[:, :2] @ motion[2:4], max(0.0, -self.options.mass * self._gravity @ turn[:, 2])
        drag = self.options.resistance * weight / np.hypot(np.linalg.norm(slide), SLOW)
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
        self._robot = robot
        self.plant_state = self.DeclareVectorInputPort("plant_state", robot.size)
        self.ball_push = self.DeclareVectorInputPort("ball_push", 2)
        forces = Value[list[ExternallyAppliedSpatialForce]]
        self.spatial_force = self.DeclareAbstractOutputPort("spatial_force", lambda: forces(), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._robot.push_ball(self.plant_state.Eval(context), self.ball_push.Eval(context)))
