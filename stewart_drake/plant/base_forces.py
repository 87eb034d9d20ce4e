"""A moving base in Drake: the forces that its motion exerts on the robot's bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.mechanics.dynamics import base_wrenches
from stewart_drake.robot.gravity import base_reading

if TYPE_CHECKING:
    from stewart_drake.plant.multibody_plant import StewartRobot


def base_forces(robot: StewartRobot, context: Context, base: np.ndarray) -> list[ExternallyAppliedSpatialForce]:
    """Forces on the bodies of a robot, in a Context of its plant, beside those of gravity, as its base moves.

    The bodies move relative to the base, which stays where it is. `base` (9,) is what its inertial unit reads.
    """
    plant, place, columns = robot.plant, robot.base, []
    bodies = [body for index in plant.GetBodyIndices(robot.instance) if (body := plant.get_body(index)).default_mass()]
    for body in bodies:
        inertia, pose, motion = (
            of(context)
            for of in (body.CalcSpatialInertiaInBodyFrame, body.EvalPoseInWorld, body.EvalSpatialVelocityInWorld)
        )
        turn, centre, spin, mass = pose.rotation().matrix(), inertia.get_com(), motion.rotational(), inertia.get_mass()
        arm, about = turn @ centre, inertia.CopyToFullMatrix6()[:3, :3]
        central = about - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        at, velocity = pose.translation() + arm - place.translation(), motion.translational() + np.cross(spin, arm)
        columns.append((mass, at, velocity, spin, turn @ central @ turn.T, centre))
    *numbers, centres = (np.array(column) for column in zip(*columns, strict=True))
    in_world = (np.reshape(base - base_reading(robot.gravity), (3, 3)) @ place.rotation().matrix().T).ravel()
    forces = []
    for body, centre, moment, force in zip(bodies, centres, *base_wrenches(in_world, *numbers), strict=True):
        applied = ExternallyAppliedSpatialForce()
        applied.body_index, applied.p_BoBq_B = body.index(), centre
        applied.F_Bq_W = SpatialForce(tau=moment, f=force)
        forces.append(applied)
    return forces


class BaseForces(LeafSystem):
    """`base_forces` of a robot whose base moves.

    Ports:
        plant_state: in (nq + nv,), the state of the plant.
        base: in (9,), see `robot.gravity.base_reading`.
        spatial_force: out, for the plant's port `applied_spatial_force`.
    """

    def __init__(self, robot: StewartRobot) -> None:
        super().__init__()
        self._robot, self._context = robot, robot.plant.CreateDefaultContext()
        size = robot.plant.num_positions() + robot.plant.num_velocities()
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        self.base = self.DeclareVectorInputPort("base", 9)
        forces = Value[list[ExternallyAppliedSpatialForce]]
        self.spatial_force = self.DeclareAbstractOutputPort("spatial_force", lambda: forces(), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        self._robot.plant.SetPositionsAndVelocities(self._context, self.plant_state.Eval(context))
        output.set_value(base_forces(self._robot, self._context, self.base.Eval(context)))
