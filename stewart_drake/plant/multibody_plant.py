"""The 14-body robot as a discrete SAP `MultibodyPlant`.

Drake holds the loops closed by six ball constraints. Their gap grows with the square of the step, about 6e-7 m at 1 ms;
the motion itself is first order in the step. Report `StewartPlant.loop_gap` with every run.

Friction that sticks is servos on the anchors of bristles: a second actuator on each motor pulls its crank towards the
anchor, implicitly, cut at its effort limit, break-away. The level in sliding lies below that: the rest, the Stribeck
torque, is added as a plain force and taken off the servo before the cut, so that the two together pull as the bristle
does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    LinearBushingRollPitchYaw,
    PdControllerGains,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    FixedInputPortValue,
    InputPort,
    LeafSystem,
    OutputPort,
)
from pydrake.systems.primitives import LinearSystem, MatrixGain, Multiplexer

from stewart_drake.base.config import NotNegative, check_value
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.jit import njit, record
from stewart_drake.base.sampling import on_grid
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.friction import level, update_bristles
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.plant.model_files import home_frames, sdf_text
from stewart_drake.plant.plant_options import DrakeOptions, RodJoint, foreign_state, platform_damping_limit
from stewart_drake.plant.state_map import StateIndices, StateMap
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

ResetFriction = Callable[[Context, np.ndarray], None]
"""Takes the tension off in a Context of the whole Diagram, at a state (nq + nv,) of the plant."""


class StewartPlant(StateMap):
    """A finalised plant in a Diagram, its two ports, and the maps to and from its state; made by `add_plant`.

    Attributes:
        plant, scene_graph: The multibody plant (nq 25, nv 24, or 31 and 30 with ball joints); the SceneGraph, or None.
        torque_input_port: (6,) [N m] motor torques, clipped to the effort limit; it must be connected or fixed.
        state_output_port, state_names, indices: (nq + nv,) the state, Drake's names of its entries, where things are.
    """

    def __init__(
        self,
        robot: RobotParameters,
        options: DrakeOptions,
        gravity: float,
        plant: MultibodyPlant,
        scene_graph: SceneGraph | None,
        torque_input_port: InputPort,
        reset_friction: ResetFriction | None = None,
    ) -> None:
        super().__init__(robot, options.rod_joint, _state_indices(plant, options.rod_joint))
        self.options, self.gravity = options, gravity
        self.plant, self.scene_graph = plant, scene_graph
        self.torque_input_port, self._reset_friction = torque_input_port, reset_friction
        # The SDF has them leg by leg, and no other constraints.
        self._closures = tuple(plant.GetConstraintIds())
        self.state_output_port: OutputPort = plant.get_state_output_port()
        self.state_names: tuple[str, ...] = tuple(plant.GetStateNames(add_model_instance_prefix=False))

    def break_rod(self, context: Context) -> None:
        """Takes `options.broken_rod` off the platform, from the next step on; `context` of the Diagram."""
        if self.options.broken_rod is not None:
            with drake_guard("breaking a rod"):
                mine = self.plant.GetMyMutableContextFromRoot(context)
                self.plant.SetConstraintActiveStatus(mine, self._closures[self.options.broken_rod.leg], False)

    def push(self, wrench: np.ndarray) -> ExternallyAppliedSpatialForce:
        """A wrench (6,) [N m, N] in B about P, the origin of the link `platform`, for `applied_spatial_force`."""
        force = ExternallyAppliedSpatialForce()
        force.body_index, force.p_BoBq_B = self.plant.GetBodyByName("platform").index(), np.zeros(3)
        force.F_Bq_W = SpatialForce(tau=wrench[:3], f=wrench[3:])
        return force

    def set_state(self, context: Context, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
        """Puts the plant into `assemble(pose, pose_rate)`, friction without tension; `context` as in `break_rod`."""
        state = self.assemble(pose, pose_rate)
        self.put(context, state)

    def put(self, context: Context, state: np.ndarray) -> None:
        """Puts the plant into a state (nq + nv,), friction without tension; `context` as in `break_rod`."""
        with drake_guard("setting the plant's state"):
            self.plant.SetPositionsAndVelocities(self.plant.GetMyMutableContextFromRoot(context), state)
            if self._reset_friction is not None:
                self._reset_friction(context, state)


def add_plant(
    builder: DiagramBuilder,
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
) -> StewartPlant:
    """Adds the robot's plant to a Diagram under construction; its default state is the home pose at rest.

    It also connects the systems for friction, and a SceneGraph for pictures or collision.

    Args:
        builder: Receives the system `plant`, and as needed `scene_graph`, `friction` and its `friction_...`.
        robot: Geometry and masses.
        options: Options of the plant; None takes the defaults.
        gravity: [m/s^2] magnitude, along -z.
        visuals: Register the geometry with a SceneGraph even where nothing collides, for visualisers and cameras.

    Raises:
        ConfigurationError: Gravity, or damping of the platform's joints, that the plant cannot have.
        DrakeCheckError: Drake refuses the model.
    """
    options = DrakeOptions() if options is None else options
    check_value("gravity", gravity, NotNegative)
    limit = platform_damping_limit(robot, options)
    if options.platform_joint_damping > limit:
        raise ConfigurationError(
            "plant.platform_joint_damping",
            options.platform_joint_damping,
            f"at most {limit:.3g} N m s/rad for this robot at a time step of {options.time_step:g} s",
        )
    with drake_guard("building the plant"):
        plant = MultibodyPlant(on_grid(options.time_step))
        plant.set_name("plant")
        # Sampled outputs would make the step an unrestricted update, which Drake takes before the discrete updates of
        # the same instant: a discrete controller or sensor would then read the state after the step.
        plant.SetUseSampledOutputPorts(False)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.set_contact_model(ContactModel.kPoint)
        scene_graph: SceneGraph | None = None
        if visuals or options.collision:
            _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
        else:
            builder.AddSystem(plant)
        text = sdf_text(robot, rod_joint=options.rod_joint, collision=options.collision, joint_swing=None)
        Parser(plant).AddModelsFromString(text, "sdf")
        plant.mutable_gravity_field().set_gravity_vector(np.array([0.0, 0.0, -gravity]))
        law = options.friction_law(robot)
        _add_damping(plant, robot, options, law["viscous"][0])
        _add_servos(plant, law)
        if options.payload_mass > 0.0:
            # A body of its own, welded on: the robot's numbers stay those of `RobotParameters` and the SDF.
            point = SpatialInertia(options.payload_mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
            payload = plant.AddRigidBody("payload", plant.GetModelInstanceByName("stewart"), point)
            at = RigidTransform(np.array(options.payload_position))
            plant.WeldFrames(plant.GetFrameByName("platform"), payload.body_frame(), at)
        plant.Finalize()
        torque_input_port, reset_friction = plant.get_actuation_input_port(), None
        if law["break_away"].any():
            torque_input_port, reset_friction = _wire_friction(builder, plant, law)
    return StewartPlant(robot, options, float(gravity), plant, scene_graph, torque_input_port, reset_friction)


def build_plant(
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
) -> tuple[Diagram, StewartPlant]:
    """A Diagram that holds `add_plant` and nothing else, with its ports exported as `torque` and `state`."""
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, options, gravity, visuals=visuals)
    with drake_guard("building the plant"):
        builder.ExportInput(stewart.torque_input_port, "torque")
        builder.ExportOutput(stewart.state_output_port, "state")
        return builder.Build(), stewart


def _add_damping(plant: MultibodyPlant, robot: RobotParameters, options: DrakeOptions, viscous: np.ndarray) -> None:
    """Damping in the tree's joints, which SAP takes implicitly, and in the loop closures, which are no joints.

    There a bushing without stiffness resists the rates of the platform's roll, pitch, yaw in the rod, zero at home.
    Drake takes its torque from the state before the step; `MultibodyPlant.CalcPotentialEnergy` raises on such a plant.
    """
    for leg in range(LEG_COUNT):
        for name, damping in (("motor", viscous[leg]), (options.rod_joint, options.universal_damping)):
            joint = plant.GetJointByName(f"{name}_{leg}")
            joint.set_default_damping_vector(np.full(joint.num_velocities(), damping))
    if options.platform_joint_damping == 0.0:
        return
    platform = plant.GetFrameByName("platform")
    zero, resistance = np.zeros(3), np.full(3, options.platform_joint_damping)
    for leg, (rotation, joint) in enumerate(zip(home_frames(robot).rod_rotation, robot.platform_joints, strict=True)):
        at_end = RigidTransform(RotationMatrix(rotation.T), [0.0, 0.0, robot.rod_lengths[leg]])
        rod = plant.GetFrameByName(f"rod_{leg}")
        rod_end = plant.AddFrame(FixedOffsetFrame(f"rod_end_{leg}", rod, at_end))
        seat = plant.AddFrame(FixedOffsetFrame(f"platform_joint_{leg}", platform, RigidTransform(joint)))
        plant.AddForceElement(LinearBushingRollPitchYaw(rod_end, seat, zero, resistance, zero, zero))


def _state_indices(plant: MultibodyPlant, rod_joint: RodJoint) -> StateIndices:
    nq = plant.num_positions()
    motors = [plant.GetJointByName(f"motor_{leg}") for leg in range(LEG_COUNT)]
    rods = [plant.GetJointByName(f"{rod_joint}_{leg}") for leg in range(LEG_COUNT)]
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


class MotorFriction(LeafSystem):
    """What friction asks of the servos, from `plant_state` and `bristles` (12,): anchors [rad], slips [rad/s] before.

    The output `pull` (18,) has anchors, slips and stribeck_torque [N m] until the next step.
    """

    def __init__(self, plant: MultibodyPlant, friction: np.ndarray) -> None:
        super().__init__()
        self._friction, self._step = friction, plant.time_step()
        joints = [plant.GetJointByName(f"motor_{leg}") for leg in range(LEG_COUNT)]
        self.cranks = np.array([joint.position_start() for joint in joints])
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.bristles = self.DeclareVectorInputPort("bristles", 2 * LEG_COUNT)
        inputs = {self.all_input_ports_ticket()}
        self.pull = self.DeclareVectorOutputPort("pull", 3 * LEG_COUNT, self._calc, prerequisites_of_calc=inputs)

    def _calc(self, context: Context, output: Any) -> None:
        state, before = self.plant_state.Eval(context), self.bristles.Eval(context)
        _servo_inputs(self._friction, before, state, self.cranks, self._step, output.get_mutable_value())


@njit
def _servo_inputs(friction: Any, before: Any, state: Any, cranks: Any, step: float, out: Any) -> None:
    """Anchors, slips and Stribeck torques (18,), break-away to level, of those before (12,) and the state now."""
    friction = record(friction)
    copy_to(out[:12], before)
    update_bristles(friction, state[cranks], step, out[:6], out[6:12])
    for i in range(6):
        slip = out[6 + i]
        out[12 + i] = np.sign(slip) * (friction.break_away[i] - level(friction, i, slip))


def _add_servos(plant: MultibodyPlant, law: np.ndarray) -> None:
    """Of motors without dry friction none; before the plant is finalised."""
    for leg in np.flatnonzero(law["break_away"][0]).tolist():
        joint = plant.GetJointByName(f"motor_{leg}")
        actuator = plant.AddJointActuator(f"friction_{leg}", joint, law["break_away"][0, leg])
        # Drake takes the rotor of a joint from its last actuator alone.
        actuator.set_default_rotor_inertia(plant.GetJointActuatorByName(f"motor_{leg}").default_rotor_inertia())
        actuator.set_controller_gains(PdControllerGains(p=law["stiffness"][0, leg], d=law["damping"][0, leg]))


def _wire_friction(builder: DiagramBuilder, plant: MultibodyPlant, law: np.ndarray) -> tuple[InputPort, ResetFriction]:
    """Feeds motors and servos of a finalised plant; gives the port of torques (6,), and what takes the tension off."""
    # What is remembered is stored by a system of Drake's: an update in Python right after the plant's step is slow.
    stored, sent = 2 * LEG_COUNT, 3 * LEG_COUNT
    store = LinearSystem(
        A=np.zeros((stored, stored)), B=np.eye(stored, sent), C=np.eye(stored), D=[], time_period=plant.time_step()
    )
    memory = builder.AddNamedSystem("friction_memory", store)
    friction = builder.AddNamedSystem("friction", MotorFriction(plant, law))
    builder.Connect(plant.get_state_output_port(), friction.plant_state)
    builder.Connect(memory.get_output_port(), friction.bristles)
    builder.Connect(friction.pull, memory.get_input_port())
    home = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    memory.configure_default_state(np.append(home[friction.cranks], np.zeros(LEG_COUNT)))
    actuators = plant.num_actuators()
    torque, desired = np.zeros((actuators, 4 * LEG_COUNT)), np.zeros((2 * actuators, 3 * LEG_COUNT))
    force = np.zeros((plant.num_velocities(), 3 * LEG_COUNT))
    for leg in range(LEG_COUNT):
        torque[plant.GetJointActuatorByName(f"motor_{leg}").input_start(), leg] = 1.0
        force[plant.GetJointByName(f"motor_{leg}").velocity_start(), 2 * LEG_COUNT + leg] = 1.0
    for leg in np.flatnonzero(law["break_away"][0]).tolist():
        servo = plant.GetJointActuatorByName(f"friction_{leg}").input_start()
        torque[servo, 3 * LEG_COUNT + leg], desired[servo, leg] = -1.0, 1.0
    both = builder.AddNamedSystem("friction_inputs", Multiplexer([LEG_COUNT, 3 * LEG_COUNT]))
    builder.Connect(friction.pull, both.get_input_port(1))
    instance = plant.GetModelInstanceByName("stewart")
    for name, matrix, source, target in (
        ("friction_torque", torque, both.get_output_port(), plant.get_actuation_input_port()),
        # A desired state left unconnected would disarm the servos without a word.
        ("friction_anchor", desired, friction.pull, plant.get_desired_state_input_port(instance)),
        ("friction_relief", force, friction.pull, plant.get_applied_generalized_force_input_port()),
    ):
        gain = builder.AddNamedSystem(name, MatrixGain(matrix))
        builder.Connect(source, gain.get_input_port())
        builder.Connect(gain.get_output_port(), target)

    def reset_friction(context: Context, state: np.ndarray) -> None:
        # Anchors and slips without tension.
        memory.GetMyMutableContextFromRoot(context).SetDiscreteState(
            np.append(state[friction.cranks], np.zeros(LEG_COUNT))
        )

    port: InputPort = both.get_input_port(0)
    return port, reset_friction


class SteppedPlant:
    """The `MultibodyPlant` as a `Plant`, for a loop that is not a Diagram: a step at a call."""

    _break_step: int | None

    def __init__(self, robot: RobotParameters, options: DrakeOptions, gravity: float) -> None:
        builder = DiagramBuilder()
        self._options, self._stewart = options, add_plant(builder, robot, options, gravity)
        plant = self._stewart.plant
        with drake_guard("building the plant"):
            builder.ExportInput(self._stewart.torque_input_port, "torque")
            self._diagram = builder.Build()
        self._force_port, self._period = plant.get_applied_spatial_force_input_port(), plant.time_step()
        self._begin()

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Begins at a pose (6,) and its rate (6,), friction without tension, all rods whole."""
        self._begin()
        self._stewart.set_state(self._context, pose, pose_rate)
        return self._measure()

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        with drake_guard("a step of the plant"):
            if self._break_step is not None and self._steps >= self._break_step:
                self._stewart.break_rod(self._context)
                self._break_step = None
            self._torque.GetMutableData().get_mutable_value().SetFromVector(torque)
            if (wrench != self._wrench).any():
                self._push(wrench)
            self._steps += 1
            self._simulator.AdvanceTo(self._steps * self._period)
        return self._measure()

    def save(self) -> tuple[int, list[np.ndarray]]:
        """Steps done, and the discrete state of the Diagram: of the plant, and of its friction where it has some."""
        state = self._context.get_discrete_state()
        return self._steps, [np.array(state.get_vector(k).value()) for k in range(state.num_groups())]

    def restore(self, state: tuple[int, list[np.ndarray]]) -> np.ndarray:
        own = [len(group) for group in self.save()[1]]
        given = [len(group) for group in state[1]] if isinstance(state, tuple) else []
        if given[:1] != own[:1]:
            raise foreign_state(state, f"a MultibodyPlant with {own[0]} numbers")
        self._begin()
        self._steps, groups = state
        with drake_guard("going on from a state"):
            self._context.SetTime(self._steps * self._period)
            self._simulator.Initialize()
            self._stewart.put(self._context, groups[0])
            # Friction that was not there before begins without tension.
            for k, values in enumerate(groups[: len(own)]):
                self._context.SetDiscreteState(k, values)
        return self._measure()

    def _begin(self) -> None:
        self._simulator, self._steps = Simulator(self._diagram), 0
        self._break_step = self._options.break_step
        self._context: Context = self._simulator.get_mutable_context()
        self._plant_context = self._stewart.plant.GetMyMutableContextFromRoot(self._context)
        self._torque: FixedInputPortValue = self._diagram.GetInputPort("torque").FixValue(self._context, np.zeros(6))
        self._push(np.zeros(6))

    def _push(self, wrench: np.ndarray) -> None:
        self._wrench = wrench.copy()
        self._force_port.FixValue(self._plant_context, [self._stewart.push(wrench)])

    def _measure(self) -> np.ndarray:
        return self._stewart.measure(self._stewart.plant.GetPositionsAndVelocities(self._plant_context))
