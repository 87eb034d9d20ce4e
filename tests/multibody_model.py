"""Exact dynamics of the closed chain in six task coordinates, out of Drake's `MultibodyPlant`.

Drake's mass matrix, bias and forces are those of the open tree; loops are closed here by eliminating the joints. With
J v = 0 the velocity of the rods' ends against their seats on the platform, columns split [joints | platform]:
v = N V, N = [-J_joints^-1 J_platform; 1], and M = N' M_tree N, h = N' (C v - forces + M_tree dN/dt V), B = N' B_tree.
Nothing is shared with the closed form over the legs in `dynamics`, so that each can check the other.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

_KV = JacobianWrtVariable.kV


@dataclass(frozen=True, eq=False)
class TaskDynamics:
    # inertia (6, 6) d(twist)/dt + bias (6,) = input_map (6, 6) T, in the twist [w, v] of P in B
    inertia: np.ndarray
    bias: np.ndarray
    input_map: np.ndarray
    # (nv, 6) velocities of the tree by the twist
    basis: np.ndarray

    def acceleration(self, torque):
        return np.linalg.solve(self.inertia, self.input_map @ torque - self.bias)


def task_dynamics(stewart, context):
    plant, index = stewart.plant, stewart.indices
    nq = plant.num_positions()
    joints = np.concatenate([index.crank_rate, index.rod_rate.ravel()]) - nq
    platform = index.twist - nq
    jacobian, drift = _loop_rows(stewart, context)
    inertia = plant.CalcMassMatrix(context)
    forces = MultibodyForces(plant)
    # Gravity, joint damping and bushings; actuation is apart.
    plant.CalcForceElementsContribution(context, forces)
    load = plant.CalcBiasTerm(context) - plant.CalcGeneralizedForces(context, forces)
    solved = np.linalg.solve(jacobian[:, joints], np.column_stack([jacobian[:, platform], drift]))
    basis, curvature = np.zeros((plant.num_velocities(), 6)), np.zeros(plant.num_velocities())
    basis[platform] = np.eye(6)
    basis[joints], curvature[joints] = -solved[:, :6], -solved[:, 6]
    return TaskDynamics(
        inertia=basis.T @ inertia @ basis,
        bias=basis.T @ (load + inertia @ curvature),
        input_map=basis[index.crank_rate - nq].T,
        basis=basis,
    )


def _loop_rows(stewart, context):
    plant, robot = stewart.plant, stewart.robot
    platform, rods = plant.GetFrameByName("platform"), [plant.GetFrameByName(f"rod_{leg}") for leg in range(6)]
    seat_rows, seat_drift = _points(plant, context, platform, robot.platform_joints.T)
    tips = [np.array([[0.0], [0.0], [length]]) for length in robot.rod_lengths]
    ends = [_points(plant, context, rod, tip) for rod, tip in zip(rods, tips, strict=True)]
    rows = [seat_rows - np.concatenate([rod_rows for rod_rows, _ in ends])]
    drift = [seat_drift - np.concatenate([rod_drift for _, rod_drift in ends])]
    if stewart.rod_joint == "ball":
        # The rods' spins, which no motion of the platform brings and which have no inertia in common with it.
        world = plant.world_frame()
        rows += [plant.CalcJacobianAngularVelocity(context, _KV, rod, world, rod)[2:] for rod in rods]
        drift.append(np.zeros(6))
    return np.concatenate(rows), np.concatenate(drift)


def _points(plant, context, frame, points):
    world = plant.world_frame()
    rows = plant.CalcJacobianTranslationalVelocity(context, _KV, frame, points, world, world)
    drift = plant.CalcBiasTranslationalAcceleration(context, _KV, frame, points, world, world)
    return rows, drift.ravel(order="F")
