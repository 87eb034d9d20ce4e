"""The 14-body robot as a discrete SAP `MultibodyPlant`.

Drake holds the loops closed by six ball constraints. Their gap grows with the square of the step, about 6e-7 m at 1 ms;
the motion itself is first order in the step. Report `StewartRobot.loop_gap` with every run.

Friction that sticks is servos on the anchors of bristles: a second actuator on each motor pulls its crank towards the
anchor, implicitly, cut at its effort limit, break-away. The level in sliding lies below that: the rest, the Stribeck
torque, is added as a plain force and taken off the servo before the cut, so that the two together pull as the bristle
does.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
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
    Frame,
    Joint,
    LinearBushingRollPitchYaw,
    ModelInstanceIndex,
    PdControllerGains,
    QuaternionFloatingJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    FixedInputPortValue,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
)
from pydrake.systems.primitives import LinearSystem, MatrixGain, Multiplexer

from stewart_drake.base.config import NotNegative, check_value
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.jit import njit, record
from stewart_drake.base.sampling import on_grid
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.friction import level, update_bristles
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.plant.context_parameters import WithParameters
from stewart_drake.plant.model_files import home_frames, sdf_text
from stewart_drake.plant.plant_options import DrakeOptions, foreign_state, platform_damping_limit
from stewart_drake.plant.state_map import StateIndices, StateMap
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

_ONCE = 1e12
"""[s] of the period of what happens once."""


class _Friction(NamedTuple):
    """Of motors that stick: the port of torques (6,), what remembers anchors and slips, and the cranks in a state."""

    torque: InputPort
    memory: LinearSystem
    cranks: np.ndarray

    def without_tension(self, state: np.ndarray) -> np.ndarray:
        return np.append(state[self.cranks], np.zeros(LEG_COUNT))


class StewartRobot(StateMap):
    """One robot in a `MultibodyPlant`, which may have other bodies and robots too; made by `add_robot` or `add_plant`.

    What needs the finished plant raises a ConfigurationError before `plant.Finalize()`.

    Attributes:
        plant, instance: The multibody plant, and the model instance of the robot in it.
        options, gravity: How its joints are, and gravity [m/s^2] as it was when the robot was added.
        scene_graph: The SceneGraph that `add_plant` made, or None.
    """

    scene_graph: SceneGraph | None = None

    def __init__(
        self,
        plant: MultibodyPlant,
        instance: ModelInstanceIndex,
        robot: RobotParameters,
        options: DrakeOptions,
        base: RigidTransform,
    ) -> None:
        super().__init__(robot, options.rod_joint)
        self.plant, self.instance, self.options = plant, instance, options
        self.gravity = float(np.linalg.norm(plant.gravity_field().gravity_vector()))
        self._base = base.rotation().matrix()
        self._law = options.friction_law(robot)
        self._start: list[np.ndarray] = []  # The default state of the robot, at rest and in motion, and its pose rate.
        self._friction: _Friction | None = None

    @cached_property
    def indices(self) -> StateIndices:  # type: ignore[override]
        """Where things are in a state of the plant."""
        self._finished()
        nq = self.plant.num_positions()
        motors = [self.joint(f"motor_{leg}") for leg in range(LEG_COUNT)]
        rods = [self.joint(f"{self.rod_joint}_{leg}") for leg in range(LEG_COUNT)]
        platform = self.joint("platform")
        first_q, first_v = platform.position_start(), platform.velocity_start()
        return StateIndices(
            crank=np.array([joint.position_start() for joint in motors]),
            rod=np.array([joint.position_start() + np.arange(joint.num_positions()) for joint in rods]),
            quaternion=first_q + np.arange(4),
            position=first_q + np.arange(4, 7),
            crank_rate=nq + np.array([joint.velocity_start() for joint in motors]),
            rod_rate=nq + np.array([joint.velocity_start() + np.arange(joint.num_velocities()) for joint in rods]),
            twist=nq + first_v + np.arange(6),
        )

    @property
    def default(self) -> np.ndarray:  # type: ignore[override]
        """(nq + nv,) the plant's default state, without motion."""
        self._finished()
        return np.append(self.plant.GetDefaultPositions(), np.zeros(self.plant.num_velocities()))

    @property
    def torque_input_port(self) -> InputPort:
        """(6,) [N m] motor torques, clipped to the effort limit; it must be connected or fixed."""
        self._finished()
        if self._friction is not None:
            return self._friction.torque
        if self._law["break_away"].any():
            raise ConfigurationError("friction", "motors that stick", "a call of connect_friction(builder) first")
        return self.plant.get_actuation_input_port(self.instance)

    @property
    def state_output_port(self) -> OutputPort:
        """(nq + nv,) the state of the plant."""
        return self.plant.get_state_output_port()

    @property
    def state_names(self) -> tuple[str, ...]:
        """Drake's names of the entries of a state, with that of the model where there are several."""
        several = self.plant.num_model_instances() > 3  # Beside the world's and the default one.
        return tuple(self.plant.GetStateNames(add_model_instance_prefix=several))

    def joint(self, name: str) -> Joint:
        """A joint of this robot."""
        return self.plant.GetJointByName(name, self.instance)

    def frame(self, name: str) -> Frame:
        """A frame of this robot: of a link, `base`, `crank_0`, `rod_0`, `platform` and so on."""
        return self.plant.GetFrameByName(name, self.instance)

    def connect_friction(self, builder: DiagramBuilder) -> None:
        """Adds the systems by which motors stick, where they do; the plant is finalised and in the builder."""
        if self._friction is None and self._law["break_away"].any():
            self._friction = _wire_friction(builder, self, self._law)

    def set_default_state(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
        """Makes `assemble(pose, pose_rate)` what a Context begins with, before the first one is made.

        Drake has default positions alone. The rates come at `Simulator.Initialize`, where the robot is still in its
        default positions and at rest, and nobody has called `set_state` or `put`. Where the platform alone is another,
        by a random distribution of its joint, the loops are closed there too.
        """
        plant, mine, start = self.plant, self.indices.all(), self.assemble(pose, pose_rate)
        positions, own = plant.GetDefaultPositions(), mine[mine < plant.num_positions()]
        positions[own] = start[own]
        with drake_guard("setting the default state"):
            plant.SetDefaultPositions(positions)
        if self._friction is not None:
            self._friction.memory.configure_default_state(self._friction.without_tension(self.default))
        if not self._start:
            begins = self._start  # An event that held this object would keep the plant for ever.
            still = self._still = plant.DeclareNumericParameter(BasicVector(np.ones(1)))
            states, is_leg = StateMap(self.robot, self.rod_joint), ~np.isin(mine, self._platform_index)
            states.indices, states.default = self.indices, self.default

            def begin(context: Context, state: State) -> None:
                values, (resting, moving, rate) = state.get_mutable_discrete_state().get_mutable_value(0), begins
                as_by_default = values[mine] == resting
                if not context.get_numeric_parameter(still)[0] or not as_by_default[is_leg].all():
                    return
                if not as_by_default.all():
                    moving = states.assemble(states.pose_and_rate(values)[0], rate)[mine]
                values[mine] = moving

            plant.DeclareInitializationUnrestrictedUpdateEvent(begin)
        self._start[:] = self.default[mine], start[mine], np.zeros(6) if pose_rate is None else np.asarray(pose_rate)

    def push(self, wrench: np.ndarray) -> ExternallyAppliedSpatialForce:
        """A wrench (6,) [N m, N] in B about P, the origin of the link `platform`, for `applied_spatial_force`."""
        force = ExternallyAppliedSpatialForce()
        force.body_index = self.plant.GetBodyByName("platform", self.instance).index()
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(tau=self._base @ wrench[:3], f=self._base @ wrench[3:])
        return force

    def set_state(self, context: Context, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
        """Puts the robot into `assemble(pose, pose_rate)`, friction without tension; `context` of the Diagram.

        All else in the plant stays as it is.
        """
        assembled, mine = self.assemble(pose, pose_rate), self.indices.all()
        with drake_guard("setting the plant's state"):
            state = self.plant.GetPositionsAndVelocities(self.plant.GetMyContextFromRoot(context))
        state[mine] = assembled[mine]
        self.put(context, state)

    def put(self, context: Context, state: np.ndarray) -> None:
        """Puts the plant into a state (nq + nv,), friction without tension; `context` as in `set_state`."""
        with drake_guard("setting the plant's state"):
            mine = self.plant.GetMyMutableContextFromRoot(context)
            self.plant.SetPositionsAndVelocities(mine, state)
            if self._start:
                mine.get_mutable_numeric_parameter(self._still).SetAtIndex(0, 0.0)
            if self._friction is not None:
                memory = self._friction.memory.GetMyMutableContextFromRoot(context)
                memory.SetDiscreteState(self._friction.without_tension(state))

    def _finished(self) -> None:
        if not self.plant.is_finalized():
            raise ConfigurationError("plant", "one under construction", "one that is finalised; call plant.Finalize()")


def add_robot(
    plant: MultibodyPlant,
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    *,
    model_instance: str = "stewart",
    base: RigidTransform | None = None,
    parser: Parser | None = None,
) -> StewartRobot:
    """Adds a robot to a plant of yours that is not finalised yet, beside whatever else it has.

    The loops are closed by ball constraints, which need a discrete plant, and Drake's contact approximation kLagged,
    kSimilar or kSap. Gravity is the plant's.

    Args:
        plant: Receives the model; register it with a SceneGraph before, for pictures and contact.
        robot: Geometry and masses.
        options: Joints, friction, payload, and whether its links collide; the time step is the plant's.
        model_instance: Name of its model instance, by which several robots differ.
        base: X_WB, where the robot's base stands; None for the world's origin.
        parser: A parser of this plant; None makes one.

    Raises:
        ConfigurationError: A plant that is finalised or continuous, a name that it has already, or damping of the
            platform's joints that the plant cannot have.
        DrakeCheckError: Drake refuses the model.
    """
    options, base = DrakeOptions() if options is None else options, RigidTransform() if base is None else base
    if plant.is_finalized():
        raise ConfigurationError("plant", "a finalised one", "one before Finalize()")
    if plant.time_step() <= 0.0:
        raise ConfigurationError("plant", "a continuous one", "a discrete one, which ball constraints need")
    if plant.HasModelInstanceNamed(model_instance):
        raise ConfigurationError("model_instance", model_instance, "a name that the plant does not have yet")
    if plant.time_step() != on_grid(options.time_step):
        options = DrakeOptions.from_dict({**options.to_dict(), "time_step": plant.time_step()})
    limit = platform_damping_limit(robot, options)
    if options.platform_joint_damping > limit:
        raise ConfigurationError(
            "plant.platform_joint_damping",
            options.platform_joint_damping,
            f"at most {limit:.3g} N m s/rad for this robot at a time step of {options.time_step:g} s",
        )
    with drake_guard("adding the robot"):
        others = set(plant.GetConstraintIds())
        at = None if base.IsExactlyIdentity() else (base.translation(), base.rotation().ToRollPitchYaw().vector())
        text = sdf_text(
            robot,
            rod_joint=options.rod_joint,
            collision=options.collision,
            joint_swing=None,
            name=model_instance,
            base=at,
        )
        (instance,) = (Parser(plant) if parser is None else parser).AddModelsFromString(text, "sdf")
        added = StewartRobot(plant, instance, robot, options, base)
        # Its coordinates are then pose and twist in B, wherever the base stands.
        floating = QuaternionFloatingJoint("platform", added.frame("base"), added.frame("platform"))
        home = RollPitchYaw(robot.home_pose[:3]).ToRotationMatrix()
        plant.AddJoint(floating).SetDefaultPose(RigidTransform(home, robot.home_pose[3:]))
        law = options.friction_law(robot)
        _add_damping(added, law["viscous"][0])
        _add_servos(added, law)
        if options.broken_rod is not None and options.break_step is not None:
            closures = [each for each in plant.GetConstraintIds() if each not in others]
            _break(plant, closures[options.broken_rod.leg], options.break_step * plant.time_step())
        if options.payload_mass > 0.0:
            # A body of its own, welded on: the robot's numbers stay those of `RobotParameters` and the SDF.
            point = SpatialInertia(options.payload_mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
            payload = plant.AddRigidBody("payload", instance, point)
            place = RigidTransform(np.array(options.payload_position))
            plant.WeldFrames(added.frame("platform"), payload.body_frame(), place)
    return added


def add_plant(
    builder: DiagramBuilder,
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
    before_finalize: Callable[[StewartRobot], None] | None = None,
    name: str = "plant",
) -> StewartRobot:
    """Adds a finished plant with the robot to a Diagram under construction: `add_robot`, its friction, a SceneGraph.

    Its default state is the home pose at rest.

    Args:
        builder: Receives the system `plant`, and as needed `scene_graph`, `friction` and its `friction_...`.
        robot: Geometry and masses.
        options: Options of the plant; None takes the defaults.
        gravity: [m/s^2] magnitude, along -z.
        visuals: Register the geometry with a SceneGraph even where nothing collides, for visualisers and cameras.
        before_finalize: Adds what else there shall be to the `plant` of the robot that it is given.
        name: Of the plant in the Diagram.

    Raises:
        ConfigurationError: Gravity, or a name, that the plant cannot have; see `add_robot`.
        DrakeCheckError: Drake refuses the model.
    """
    options = DrakeOptions() if options is None else options
    check_value("gravity", gravity, NotNegative)
    if builder.HasSubsystemNamed(name):
        raise ConfigurationError("name", name, "one that no other system of the Diagram has")
    with drake_guard("building the plant"):
        plant = MultibodyPlant(on_grid(options.time_step))
        plant.set_name(name)
        # A plant with sampled outputs steps in an unrestricted update, which costs a copy of all states.
        plant.SetUseSampledOutputPorts(False)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.set_contact_model(ContactModel.kPoint)
        scene_graph: SceneGraph | None = None
        if visuals or options.collision:
            _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
        else:
            builder.AddSystem(plant)
        plant.mutable_gravity_field().set_gravity_vector(np.array([0.0, 0.0, -gravity]))
    added = add_robot(plant, robot, options)
    added.scene_graph = scene_graph
    if before_finalize is not None:
        before_finalize(added)
    with drake_guard("building the plant"):
        plant.Finalize()
        added.connect_friction(builder)
    return added


def build_plant(
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: float = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
) -> tuple[Diagram, StewartRobot]:
    """A Diagram that holds `add_plant` and nothing else, with its ports exported as `torque` and `state`."""
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, options, gravity, visuals=visuals)
    with drake_guard("building the plant"):
        builder.ExportInput(stewart.torque_input_port, "torque")
        builder.ExportOutput(stewart.state_output_port, "state")
        return builder.Build(), stewart


def _break(plant: MultibodyPlant, closure: Any, time: float) -> None:
    """Takes a rod off the platform at a time [s], in every Context that passes it or begins beyond it."""
    # An event that held the plant would keep it for ever.
    there: Any = weakref.ref(plant)

    def set_closed(context: Context, _: State) -> None:
        there().SetConstraintActiveStatus(context, closure, context.get_time() < time)

    plant.DeclareInitializationUnrestrictedUpdateEvent(set_closed)
    plant.DeclarePeriodicUnrestrictedUpdateEvent(_ONCE, time, set_closed)


def _add_damping(added: StewartRobot, viscous: np.ndarray) -> None:
    """Damping in the tree's joints, which SAP takes implicitly, and in the loop closures, which are no joints.

    There a bushing without stiffness resists the rates of the platform's roll, pitch, yaw in the rod, zero at home.
    Drake takes its torque from the state before the step; `MultibodyPlant.CalcPotentialEnergy` raises on such a plant.
    """
    plant, robot, options = added.plant, added.robot, added.options
    for leg in range(LEG_COUNT):
        for name, damping in (("motor", viscous[leg]), (options.rod_joint, options.universal_damping)):
            joint = added.joint(f"{name}_{leg}")
            joint.set_default_damping_vector(np.full(joint.num_velocities(), damping))
    if options.platform_joint_damping == 0.0:
        return
    platform = added.frame("platform")
    zero, resistance = np.zeros(3), np.full(3, options.platform_joint_damping)
    for leg, (rotation, joint) in enumerate(zip(home_frames(robot).rod_rotation, robot.platform_joints, strict=True)):
        at_end = RigidTransform(RotationMatrix(rotation.T), [0.0, 0.0, robot.rod_lengths[leg]])
        rod = added.frame(f"rod_{leg}")
        rod_end = plant.AddFrame(FixedOffsetFrame(f"rod_end_{leg}", rod, at_end))
        seat = plant.AddFrame(FixedOffsetFrame(f"platform_joint_{leg}", platform, RigidTransform(joint)))
        plant.AddForceElement(LinearBushingRollPitchYaw(rod_end, seat, zero, resistance, zero, zero))


class MotorFriction(LeafSystem, WithParameters):
    """What friction asks of the servos, from `plant_state` and `bristles` (12,): anchors [rad], slips [rad/s] before.

    The output `pull` (18,) has anchors, slips and stribeck_torque [N m] until the next step. The parameter `friction`
    is a `FRICTION` record; its break_away and viscous count in the plant, where they are a motor's limit and damping.
    """

    def __init__(self, robot: StewartRobot, friction: np.ndarray) -> None:
        super().__init__()
        plant = robot.plant
        self._step, self.cranks = plant.time_step(), robot.indices.crank
        self._friction = self.declare_parameters({"friction": friction})["friction"]
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.bristles = self.DeclareVectorInputPort("bristles", 2 * LEG_COUNT)
        needs = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.pull = self.DeclareVectorOutputPort("pull", 3 * LEG_COUNT, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Context, output: Any) -> None:
        state, before = self.plant_state.Eval(context), self.bristles.Eval(context)
        self.read_parameters(context)
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


def _add_servos(added: StewartRobot, law: np.ndarray) -> None:
    """Of motors without dry friction none; before the plant is finalised."""
    plant = added.plant
    for leg in np.flatnonzero(law["break_away"][0]).tolist():
        actuator = plant.AddJointActuator(f"friction_{leg}", added.joint(f"motor_{leg}"), law["break_away"][0, leg])
        # Drake takes the rotor of a joint from its last actuator alone.
        motor = plant.GetJointActuatorByName(f"motor_{leg}", added.instance)
        actuator.set_default_rotor_inertia(motor.default_rotor_inertia())
        actuator.set_controller_gains(PdControllerGains(p=law["stiffness"][0, leg], d=law["damping"][0, leg]))


def _wire_friction(builder: DiagramBuilder, robot: StewartRobot, law: np.ndarray) -> _Friction:
    """Feeds motors and servos of a finalised plant."""
    plant, instance = robot.plant, robot.instance
    model = plant.GetModelInstanceName(instance)
    prefix = "friction" if model == "stewart" else f"{model}_friction"
    # What is remembered is stored by a system of Drake's: an update in Python right after the plant's step is slow.
    stored, sent = 2 * LEG_COUNT, 3 * LEG_COUNT
    store = LinearSystem(
        A=np.zeros((stored, stored)), B=np.eye(stored, sent), C=np.eye(stored), D=[], time_period=plant.time_step()
    )
    memory = builder.AddNamedSystem(f"{prefix}_memory", store)
    friction = builder.AddNamedSystem(prefix, MotorFriction(robot, law))
    builder.Connect(plant.get_state_output_port(), friction.plant_state)
    builder.Connect(memory.get_output_port(), friction.bristles)
    builder.Connect(friction.pull, memory.get_input_port())
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(instance)]
    row = {actuator.name(): place for place, actuator in enumerate(actuators)}
    torque, desired = np.zeros((len(row), 4 * LEG_COUNT)), np.zeros((2 * len(row), 3 * LEG_COUNT))
    force = np.zeros((plant.num_velocities(), 3 * LEG_COUNT))
    for leg in range(LEG_COUNT):
        torque[row[f"motor_{leg}"], leg] = 1.0
        force[robot.joint(f"motor_{leg}").velocity_start(), 2 * LEG_COUNT + leg] = 1.0
    for leg in np.flatnonzero(law["break_away"][0]).tolist():
        servo = row[f"friction_{leg}"]
        torque[servo, 3 * LEG_COUNT + leg], desired[servo, leg] = -1.0, 1.0
    both = builder.AddNamedSystem(f"{prefix}_inputs", Multiplexer([LEG_COUNT, 3 * LEG_COUNT]))
    builder.Connect(friction.pull, both.get_input_port(1))
    for name, matrix, source, target in (
        ("torque", torque, both.get_output_port(), plant.get_actuation_input_port(instance)),
        # A desired state left unconnected would disarm the servos without a word.
        ("anchor", desired, friction.pull, plant.get_desired_state_input_port(instance)),
        ("relief", force, friction.pull, plant.get_applied_generalized_force_input_port()),
    ):
        gain = builder.AddNamedSystem(f"{prefix}_{name}", MatrixGain(matrix))
        builder.Connect(source, gain.get_input_port())
        builder.Connect(gain.get_output_port(), target)

    wired = _Friction(both.get_input_port(0), memory, friction.cranks)
    memory.configure_default_state(wired.without_tension(robot.default))
    return wired


class SteppedPlant:
    """The `MultibodyPlant` as a `Plant`, for a loop that is not a Diagram: a step at a call."""

    def __init__(self, robot: RobotParameters, options: DrakeOptions, gravity: float) -> None:
        builder = DiagramBuilder()
        self._stewart = add_plant(builder, robot, options, gravity)
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
        self._context: Context = self._simulator.get_mutable_context()
        self._plant_context = self._stewart.plant.GetMyMutableContextFromRoot(self._context)
        self._torque: FixedInputPortValue = self._diagram.GetInputPort("torque").FixValue(self._context, np.zeros(6))
        self._push(np.zeros(6))

    def _push(self, wrench: np.ndarray) -> None:
        self._wrench = wrench.copy()
        self._force_port.FixValue(self._plant_context, [self._stewart.push(wrench)])

    def _measure(self) -> np.ndarray:
        return self._stewart.measure(self._stewart.plant.GetPositionsAndVelocities(self._plant_context))
