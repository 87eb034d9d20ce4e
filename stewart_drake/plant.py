"""The 14-body robot as a discrete SAP `MultibodyPlant`, and the maps between its state and the platform's pose.

Drake holds the loops closed by six ball constraints. Their gap grows with the square of the step, about 6e-7 m at 1 ms;
the motion itself is first order in the step. Report `StewartPlant.loop_gap` with every run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import FixedOffsetFrame, LinearBushingRollPitchYaw, PdControllerGains
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from stewart_drake.errors import ConfigurationError, SingularPoseError, drake_guard
from stewart_drake.kinematics import (
    cross,
    leg_geometry,
    pose_rate_to_twist,
    roll_pitch_yaw,
    rotation_matrix,
)
from stewart_drake.plant_options import STICTION_SPEED, PlantOptions, is_finite
from stewart_drake.rigid_body_model import STANDARD_GRAVITY
from stewart_drake.robot import LEGS, RobotParameters
from stewart_drake.sampling import on_grid
from stewart_drake.sdf_model import RodJoint, crank_lateral, home_frames, sdf_text


@dataclass(frozen=True, eq=False)
class StateIndices:
    """Where things are in a state [positions; velocities] of the plant.

    Attributes:
        crank: (6,) motor angles, zero at home.
        rod: (6, 2 or 3) angles of the joints between crank and rod.
        quaternion: (4,) w, x, y, z of the platform.
        position: (3,) X, Y, Z of the platform.
        crank_rate: (6,) motor speeds.
        rod_rate: (6, 2 or 3) velocities of the joints between crank and rod.
        twist: (6,) w_BP, v_BP of the platform, both in B.
    """

    crank: np.ndarray
    rod: np.ndarray
    quaternion: np.ndarray
    position: np.ndarray
    crank_rate: np.ndarray
    rod_rate: np.ndarray
    twist: np.ndarray


class StewartPlant:
    """A finalised plant in a Diagram, its two ports, and the maps to and from its state; made by `add_plant`.

    A state is Drake's [positions; velocities], as the state port gives it. The maps are numpy only and vectorised over
    leading axes, so they serve a log as well as an instant; angles of cranks are theta, not Drake's zero-at-home angle.

    Ports: torque (6,) [N m], clipped to the effort limit; state (nq + nv,).

    Attributes:
        robot: Geometry and masses.
        options: What else is modelled.
        gravity: [m/s^2] along -z.
        plant: The multibody plant: nq 25 and nv 24, or 31 and 30 with ball joints on the cranks.
        scene_graph: Where the geometry is registered, or None.
        torque_input_port: (6,) [N m] motor torques, however many actuators friction needs inside.
        state_output_port: (nq + nv,) the state.
        state_names: Drake's names of the state's entries, (nq + nv).
        indices: Where things are in the state.
    """

    def __init__(
        self,
        robot: RobotParameters,
        options: PlantOptions,
        gravity: float,
        plant: MultibodyPlant,
        scene_graph: SceneGraph | None,
        torque_input_port: InputPort,
    ) -> None:
        self.robot, self.options, self.gravity = robot, options, gravity
        self.plant, self.scene_graph = plant, scene_graph
        self.torque_input_port = torque_input_port
        self.state_output_port: OutputPort = plant.get_state_output_port()
        self.state_names: tuple[str, ...] = tuple(plant.GetStateNames(add_model_instance_prefix=False))
        self.indices = _state_indices(plant, options.rod_joint)
        self._home = home_frames(robot)
        self._lateral = crank_lateral(robot)

    def assemble(self, pose: np.ndarray, pose_rate: np.ndarray | None = None) -> np.ndarray:
        """State of the closed robot with the platform at a pose, moving; in closed form, rods not spinning.

        Args:
            pose: (..., 6) [rad, m] of P in B.
            pose_rate: (..., 6) [rad/s, m/s] Euler rates and velocity; None is rest.

        Returns:
            (..., nq + nv) the state; its loops are closed to rounding.

        Raises:
            UnreachablePoseError: A rod cannot span.
            SingularPoseError: A crank at its dead centre, whose speed is not defined.
            ConfigurationError: Not finite, or not (..., 6).
        """
        pose = np.asarray(pose, dtype=float)
        pose_rate = np.zeros_like(pose) if pose_rate is None else np.asarray(pose_rate, dtype=float)
        if pose_rate.shape != pose.shape or not np.isfinite(pose_rate).all():
            raise ConfigurationError("pose_rate", pose_rate, f"finite numbers of the pose's shape {pose.shape}")
        legs = leg_geometry(self.robot, pose)
        nearest = np.abs(legs.transmission)
        if nearest.min(initial=1.0) < 1e-9:
            at = np.unravel_index(int(nearest.argmin()), nearest.shape)
            raise SingularPoseError("serial", pose[at[:-1]], float(nearest[at]), 1e-9, int(at[-1]))

        twist = pose_rate_to_twist(pose, pose_rate)
        v_joint = twist[..., None, 3:] + cross(twist[..., None, :3], legs.arm)
        theta_rate = np.sum(legs.e_l * v_joint, axis=-1) / (self.robot.crank_length * legs.transmission)
        v_tip = self.robot.crank_length * legs.e_n * theta_rate[..., None]
        e_l_rate = (v_joint - v_tip) / self.robot.rod_length

        w_crank = -self._lateral * theta_rate[..., None]
        crank_rotation = np.stack(np.broadcast_arrays(legs.crank, self._lateral, legs.e_n), axis=-1)
        to_joint = np.swapaxes(crank_rotation @ self._home.rod_in_crank, -1, -2)
        direction = _times(to_joint, legs.e_l)
        angles = _universal_angles(direction)
        if self.options.rod_joint == "universal":
            rates = _universal_rates(angles, _times(to_joint, e_l_rate - cross(w_crank, legs.e_l)))
        else:
            angles = roll_pitch_yaw(_universal_rotation(angles))
            rates = _times(to_joint, cross(legs.e_l, e_l_rate) - w_crank)

        index = self.indices
        state = np.zeros((*pose.shape[:-1], self.plant.num_multibody_states()))
        state[..., index.crank] = _wrapped(legs.crank_angles - self._home.crank_angles)
        state[..., index.rod] = angles
        state[..., index.quaternion] = _quaternion(pose[..., :3])
        state[..., index.position] = pose[..., 3:]
        state[..., index.crank_rate] = theta_rate
        state[..., index.rod_rate] = rates
        state[..., index.twist] = twist
        return state

    def set_state(self, context: Context, pose: np.ndarray, pose_rate: np.ndarray | None = None) -> None:
        """Puts the plant into `assemble(pose, pose_rate)`.

        Args:
            context: Context of the whole Diagram, not the plant's own in it.
            pose: (6,) [rad, m].
            pose_rate: (6,) [rad/s, m/s]; None is rest.

        Raises:
            UnreachablePoseError, SingularPoseError, ConfigurationError: As in `assemble`.
            DrakeCheckError: The Context is not that of the Diagram around this plant.
        """
        state = self.assemble(pose, pose_rate)
        with drake_guard("setting the plant's state"):
            self.plant.SetPositionsAndVelocities(self.plant.GetMyMutableContextFromRoot(context), state)

    def pose_and_rate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the platform and its rate.

        Args:
            state: (..., nq + nv).

        Returns:
            (..., 6) [rad, m], pitch in [-pi/2, pi/2], and (..., 6) [rad/s, m/s] Euler rates and velocity.
        """
        state = np.asarray(state, dtype=float)
        pose, rate = np.empty((2, *state.shape[:-1], 6))
        pose[..., 3:] = state[..., self.indices.position]
        rate[..., 3:] = state[..., self.indices.twist[3:]]
        # Component by component: a sensor asks at every tick, and matrices would cost more than the plant's own step.
        w, x, y, z = (state[..., i] for i in self.indices.quaternion)
        size = w * w + x * x + y * y + z * z
        pose[..., 0] = np.arctan2(2.0 * (w * x + y * z), size - 2.0 * (x * x + y * y))
        pose[..., 1] = np.arcsin(np.clip(2.0 * (w * y - x * z) / size, -1.0, 1.0))
        pose[..., 2] = np.arctan2(2.0 * (w * z + x * y), size - 2.0 * (y * y + z * z))
        w_x, w_y, w_z = (state[..., i] for i in self.indices.twist[:3])
        cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        rate[..., 0] = (cosine * w_x + sine * w_y) / np.cos(pose[..., 1])
        rate[..., 1] = cosine * w_y - sine * w_x
        rate[..., 2] = w_z + np.sin(pose[..., 1]) * rate[..., 0]
        return pose, rate

    def crank_angles(self, state: np.ndarray) -> np.ndarray:
        """Angles theta of the cranks.

        Args:
            state: (..., nq + nv).

        Returns:
            (..., 6) [rad], not wrapped.
        """
        angles: np.ndarray = np.asarray(state, dtype=float)[..., self.indices.crank] + self._home.crank_angles
        return angles

    def crank_rates(self, state: np.ndarray) -> np.ndarray:
        """Speeds of the cranks.

        Args:
            state: (..., nq + nv).

        Returns:
            (..., 6) [rad/s].
        """
        rates: np.ndarray = np.asarray(state, dtype=float)[..., self.indices.crank_rate]
        return rates

    def loop_gap(self, state: np.ndarray) -> np.ndarray:
        """Distance between each rod's end and its joint on the platform, which constraints keep near zero.

        Args:
            state: (..., nq + nv).

        Returns:
            (..., 6) [m].
        """
        state = np.asarray(state, dtype=float)
        theta = self.crank_angles(state)
        cosine, sine = np.cos(theta)[..., None], np.sin(theta)[..., None]
        along, up = self.robot.crank_zero_directions, np.array([0.0, 0.0, 1.0])
        crank, e_n = cosine * along + sine * up, cosine * up - sine * along
        angles = state[..., self.indices.rod]
        turned = _universal_rotation(angles) if self.options.rod_joint == "universal" else rotation_matrix(angles)
        x, y, z = np.moveaxis(_times(self._home.rod_in_crank, turned[..., 2]), -1, 0)
        e_l = x[..., None] * crank + y[..., None] * self._lateral + z[..., None] * e_n
        end = self.robot.shaft_positions + self.robot.crank_length * crank + self.robot.rod_length * e_l
        rotation = _quaternion_rotation(state[..., self.indices.quaternion])
        arm = self.robot.platform_joints @ np.swapaxes(rotation, -1, -2)
        gap: np.ndarray = np.linalg.norm(end - arm - state[..., None, self.indices.position], axis=-1)
        return gap


def add_plant(
    builder: DiagramBuilder,
    robot: RobotParameters,
    options: PlantOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
) -> StewartPlant:
    """Adds the robot's plant to a Diagram under construction; its default state is the home pose at rest.

    Like Drake's `AddMultibodyPlantSceneGraph` it wires what belongs to the plant alone: the SceneGraph, and the two
    sources that friction needs. Where neither pictures nor collision are asked for there is no SceneGraph.

    Args:
        builder: Receives the system `plant`, and as needed `scene_graph`, `friction_torque`, `friction_target`.
        robot: Geometry and masses.
        options: What else is modelled; None takes the defaults.
        gravity: [m/s^2] magnitude, along -z.
        visuals: Register the geometry with a SceneGraph even where nothing collides, for visualisers and cameras.

    Returns:
        The plant and its ports. The torque port must be connected or fixed.

    Raises:
        ConfigurationError: Gravity is negative or not finite.
        DrakeCheckError: Drake refuses the model.
    """
    options = PlantOptions() if options is None else options
    if not is_finite(gravity) or gravity < 0.0:
        raise ConfigurationError("gravity", gravity, "a finite number of m/s^2, zero or positive")
    with drake_guard("building the plant"):
        plant = MultibodyPlant(on_grid(options.time_step))
        plant.set_name("plant")
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.set_contact_model(ContactModel.kPoint)
        scene_graph: SceneGraph | None = None
        if visuals or options.collision:
            _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
        else:
            builder.AddSystem(plant)
        text = sdf_text(robot, rod_joint=options.rod_joint, collision=options.collision)
        Parser(plant).AddModelsFromString(text, "sdf")
        plant.mutable_gravity_field().set_gravity_vector(np.array([0.0, 0.0, -gravity]))
        _add_damping(plant, robot, options)
        if options.motor_friction > 0.0:
            _add_friction_actuators(plant, options.motor_friction)
        plant.Finalize()
        torque_input_port = plant.get_actuation_input_port()
        if options.motor_friction > 0.0:
            torque_input_port = _wire_friction(builder, plant)
    return StewartPlant(robot, options, float(gravity), plant, scene_graph, torque_input_port)


def build_plant(
    robot: RobotParameters,
    options: PlantOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
) -> tuple[Diagram, StewartPlant]:
    """A Diagram that holds the plant and nothing else, with its ports exported as `torque` and `state`.

    Args:
        robot: Geometry and masses.
        options: As in `add_plant`.
        gravity: As in `add_plant`.
        visuals: As in `add_plant`.

    Raises:
        ConfigurationError, DrakeCheckError: As in `add_plant`.
    """
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, options, gravity, visuals=visuals)
    with drake_guard("building the plant"):
        builder.ExportInput(stewart.torque_input_port, "torque")
        builder.ExportOutput(stewart.state_output_port, "state")
        return builder.Build(), stewart


def _add_damping(plant: MultibodyPlant, robot: RobotParameters, options: PlantOptions) -> None:
    # Not in the SDF: there Drake reads the damping of a universal joint's first axis only.
    for leg in range(LEGS):
        for name, damping in (("motor", options.motor_damping), (options.rod_joint, options.universal_damping)):
            joint = plant.GetJointByName(f"{name}_{leg}")
            joint.set_default_damping_vector(np.full(joint.num_velocities(), damping))
    if options.platform_joint_damping == 0.0:
        return
    platform = plant.GetFrameByName("platform")
    zero, resistance = np.zeros(3), np.full(3, options.platform_joint_damping)
    for leg, (rotation, joint) in enumerate(zip(home_frames(robot).rod_rotation, robot.platform_joints, strict=True)):
        at_end = RigidTransform(RotationMatrix(rotation.T), [0.0, 0.0, robot.rod_length])
        rod = plant.GetFrameByName(f"rod_{leg}")
        rod_end = plant.AddFrame(FixedOffsetFrame(f"rod_end_{leg}", rod, at_end))
        seat = plant.AddFrame(FixedOffsetFrame(f"platform_joint_{leg}", platform, RigidTransform(joint)))
        plant.AddForceElement(LinearBushingRollPitchYaw(rod_end, seat, zero, resistance, zero, zero))


def _add_friction_actuators(plant: MultibodyPlant, friction: float) -> None:
    gains = PdControllerGains(p=0.0, d=friction / STICTION_SPEED)
    for leg in range(LEGS):
        actuator = plant.AddJointActuator(f"friction_{leg}", plant.GetJointByName(f"motor_{leg}"), friction)
        actuator.set_controller_gains(gains)


def _wire_friction(builder: DiagramBuilder, plant: MultibodyPlant) -> InputPort:
    """Feeds the twelve actuators: motors from the port returned, friction from zeros."""
    rows = [plant.GetJointActuatorByName(f"motor_{leg}").input_start() for leg in range(LEGS)]
    selection = np.zeros((plant.num_actuators(), LEGS))
    selection[rows, np.arange(LEGS)] = 1.0
    spread = builder.AddNamedSystem("friction_torque", MatrixGain(selection))
    # A desired state left unconnected would disarm the servos without a word.
    target = builder.AddNamedSystem("friction_target", ConstantVectorSource(np.zeros(2 * plant.num_actuators())))
    instance = plant.GetModelInstanceByName("stewart")
    builder.Connect(spread.get_output_port(), plant.get_actuation_input_port())
    builder.Connect(target.get_output_port(), plant.get_desired_state_input_port(instance))
    port: InputPort = spread.get_input_port()
    return port


def _state_indices(plant: MultibodyPlant, rod_joint: RodJoint) -> StateIndices:
    nq = plant.num_positions()
    motors = [plant.GetJointByName(f"motor_{leg}") for leg in range(LEGS)]
    rods = [plant.GetJointByName(f"{rod_joint}_{leg}") for leg in range(LEGS)]
    platform = plant.GetBodyByName("platform")
    first_q, first_v = platform.floating_positions_start(), platform.floating_velocities_start_in_v()
    return StateIndices(
        crank=np.array([joint.position_start() for joint in motors]),
        rod=np.array([joint.position_start() + np.arange(joint.num_positions()) for joint in rods]),
        quaternion=first_q + np.arange(4),
        position=first_q + np.arange(4, 7),
        crank_rate=nq + np.array([joint.velocity_start() for joint in motors]),
        rod_rate=nq + np.array([joint.velocity_start() + np.arange(joint.num_velocities()) for joint in rods]),
        twist=nq + first_v + np.arange(6),
    )


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    product: np.ndarray = (matrix @ vector[..., None])[..., 0]
    return product


def _wrapped(angle: np.ndarray) -> np.ndarray:
    wrapped: np.ndarray = np.arctan2(np.sin(angle), np.cos(angle))
    return wrapped


def _universal_angles(direction: np.ndarray) -> np.ndarray:
    """(..., 2) [rad] a, b for which Rx(a) Ry(b) z is `direction`: [sin b, -sin a cos b, cos a cos b]."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z))], axis=-1)


def _universal_rates(angles: np.ndarray, direction_rate: np.ndarray) -> np.ndarray:
    """(..., 2) [rad/s] rates of a, b from the time derivative of the direction, both in the joint's frame F."""
    x, y, z = np.moveaxis(direction_rate, -1, 0)
    (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    return np.stack([-(ca * y + sa * z) / cb, cb * x + sb * (sa * y - ca * z)], axis=-1)


def _universal_rotation(angles: np.ndarray) -> np.ndarray:
    """(..., 3, 3) [-] Rx(a) Ry(b)."""
    (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    zero = np.zeros_like(sa)
    rows = [[cb, zero, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _quaternion(rpy: np.ndarray) -> np.ndarray:
    """(..., 4) [-] w, x, y, z of `rotation_matrix(rpy)`."""
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(0.5 * rpy), -1, 0), np.moveaxis(np.cos(0.5 * rpy), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def _quaternion_rotation(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3, 3) [-] rotation of a quaternion of any length, as Drake reads it."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
