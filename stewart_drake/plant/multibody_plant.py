"""The 14-body robot as a discrete SAP `MultibodyPlant`.

Six ball constraints close the loops. Their gap grows with the square of the step, about 6e-7 m at 1 ms; the motion
itself is first order in the step. Report `StewartRobot.loop_gap` with every run.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cached_property
from typing import cast

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
    MultibodyConstraintId,
    QuaternionFloatingJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    State,
)

from stewart_drake.base.arguments import checked
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.sampling import decimal, on_grid
from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.plant.drake_ball import BallBody
from stewart_drake.plant.model_files import home_frames, sdf_text
from stewart_drake.plant.plant_options import DrakeOptions, platform_damping_limit
from stewart_drake.plant.servo_friction import FrictionSystems, add_servos, wire_friction
from stewart_drake.plant.state_map import StateIndices, StateMap
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import Gravity, check_gravity, gravity_vector
from stewart_drake.robot.leg import LEG_COUNT

_ONCE = 1e12
"""[s] period of an event that happens once."""


class StewartRobot(StateMap):
    """One robot in a `MultibodyPlant`, which may have other bodies and robots; made by `add_robot` or `add_plant`.

    Methods that need the finished plant raise a ConfigurationError before `plant.Finalize()`.

    Attributes:
        plant, instance: The multibody plant, and the model instance of the robot in it.
        options, gravity: Options of its joints, and gravity [m/s^2] in B when the robot was added: a number along -z,
            or a vector.
        base: X_WB, pose of its base in the world.
        scene_graph, ball: SceneGraph and ball that `add_plant` made, or None.
    """

    scene_graph: SceneGraph | None = None
    ball: BallBody | None = None
    where_from = "add_robot and add_plant return one"

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
        self.base = base
        self._base = base.rotation().matrix()
        x, y, z = self._base.T @ plant.gravity_field().gravity_vector()
        self.gravity: Gravity = float(-z) if max(abs(x), abs(y)) <= 1e-12 * abs(z) else (float(x), float(y), float(z))
        self._law = options.friction_of(robot)
        self._start: list[np.ndarray] = []  # The default state of the robot, at rest and in motion, and its pose rate.
        self._friction: FrictionSystems | None = None

    @cached_property
    def indices(self) -> StateIndices:  # type: ignore[override]
        """Indices of the robot in a state of the plant."""
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
    def _mine(self) -> np.ndarray:
        return np.append(self.indices.all(), () if self.ball is None else self.ball.indices).astype(int)

    def assemble(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> np.ndarray:
        """As `StateMap.assemble`; a ball is where it starts."""
        state = super().assemble(pose, pose_rate)
        return state if self.ball is None else self.ball.at_start(self, state)

    def measure(self, state: np.ndarray) -> np.ndarray:
        """As `StateMap.measure`, (..., 29) with a ball, see `plant_options.BALL`."""
        measured = super().measure(state)
        return measured if self.ball is None else np.append(measured, self.ball.motion(self, state), axis=-1)

    @property
    def torque_input_port(self) -> InputPort:
        """(6,) [N m] motor torques, clipped to the effort limit; zero if not connected, except with stiction."""
        self._finished()
        if self._friction is not None:
            return self._friction.torque
        if self._law["break_away"].any():
            raise ConfigurationError("friction", "motors that stick", "a call of connect_friction(builder) first")
        return self.plant.get_actuation_input_port(self.instance)

    @property
    def state_output_port(self) -> OutputPort:
        """(nq + nv,) the state of the plant."""
        self._finished()
        return self.plant.get_state_output_port()

    @property
    def state_names(self) -> tuple[str, ...]:
        """Drake's names of the entries of a state, with the name of the model if there are several."""
        several = self.plant.num_model_instances() > 3  # Beside the world's and the default one.
        return tuple(self.plant.GetStateNames(add_model_instance_prefix=several))

    def joint(self, name: str) -> Joint:
        """A joint of this robot."""
        return self.plant.GetJointByName(name, self.instance)

    def frame(self, name: str) -> Frame:
        """A frame of this robot: of a link, `base`, `crank_0`, `rod_0`, `platform` and so on."""
        return self.plant.GetFrameByName(name, self.instance)

    def connect_friction(self, builder: DiagramBuilder) -> None:
        """Adds the systems of stiction, if the motors have it; the plant is finalised and in the builder."""
        if self._friction is None and self._law["break_away"].any():
            self._finished()
            with drake_guard("connecting the friction"):
                self._friction = wire_friction(builder, self, self._law)

    def set_default_state(self, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
        """Makes `assemble(pose, pose_rate)` the default state of a Context; before the first Context is made.

        Drake has default positions only. The rates are set at `Simulator.Initialize`, if the robot is still at rest in
        its default positions, and neither `set_state` nor `put` was called. If only the platform has been moved, by a
        random distribution of its joint, the loops are closed there.
        """
        plant, mine, start = self.plant, self._mine, self.assemble(pose, pose_rate)
        positions, moved = plant.GetDefaultPositions(), mine[mine < plant.num_positions()]
        positions[moved] = start[moved]
        with drake_guard("setting the default state"):
            plant.SetDefaultPositions(positions)
        if self._friction is not None:
            self._friction.memory.configure_default_state(self._friction.relaxed(self.default))
        if not self._start:
            begins = self._start  # An event that refers to this object would keep the plant alive.
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

    def push(self, wrench: ArrayLike) -> ExternallyAppliedSpatialForce:
        """A wrench (6,) [N m, N] in B about P, the origin of the link `platform`, for `applied_spatial_force`."""
        wrench = np.asarray(wrench, dtype=float)
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise ConfigurationError("wrench", wrench, "moment [N m] and force [N], six finite numbers")
        force = ExternallyAppliedSpatialForce()
        force.body_index = self.plant.GetBodyByName("platform", self.instance).index()
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(tau=self._base @ wrench[:3], f=self._base @ wrench[3:])
        return force

    @checked
    def set_state(self, context: Context, pose: ArrayLike, pose_rate: ArrayLike | None = None) -> None:
        """Sets the robot's state to `assemble(pose, pose_rate)`, with relaxed bristles; `context` of the Diagram.

        The rest of the plant is not changed.
        """
        assembled, mine = self.assemble(pose, pose_rate), self._mine
        with drake_guard("setting the plant's state"):
            state = self.plant.GetPositionsAndVelocities(self.plant.GetMyContextFromRoot(context))
        state[mine] = assembled[mine]
        self.put(context, state)

    @checked
    def put(self, context: Context, state: np.ndarray) -> None:
        """Sets the plant's state (nq + nv,), with relaxed bristles; `context` as in `set_state`."""
        state = self.checked(state)
        with drake_guard("setting the plant's state"):
            mine = self.plant.GetMyMutableContextFromRoot(context)
            self.plant.SetPositionsAndVelocities(mine, state)
            if self._start:
                mine.get_mutable_numeric_parameter(self._still).SetAtIndex(0, 0.0)
            if self._friction is not None:
                memory = self._friction.memory.GetMyMutableContextFromRoot(context)
                memory.SetDiscreteState(self._friction.relaxed(state))

    def _finished(self) -> None:
        if not self.plant.is_finalized():
            raise ConfigurationError("plant", "one under construction", "one that is finalised; call plant.Finalize()")


@checked
def add_robot(
    plant: MultibodyPlant,
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    *,
    model_instance: str = "stewart",
    base: RigidTransform | None = None,
    parser: Parser | None = None,
) -> StewartRobot:
    """Adds a robot to a plant of yours that is not finalised yet.

    The loops are closed by ball constraints, which need a discrete plant, and Drake's contact approximation kLagged,
    kSimilar or kSap. Gravity is the plant's.

    Args:
        plant: Receives the model; register it with a SceneGraph before, for pictures and contact.
        robot: Geometry and masses.
        options: Joints, friction, payload, and whether its links collide; the time step is the plant's.
        model_instance: Name of its model instance, different for every robot.
        base: X_WB, pose of the robot's base; None for the world's origin.
        parser: A parser of this plant; None makes one.

    Raises:
        ConfigurationError: A plant that is finalised or continuous, a name that it has already, or damping of the
            platform's joints that the plant cannot have.
        DrakeCheckError: Drake refuses the model.
    """
    options, base = DrakeOptions() if options is None else options, RigidTransform() if base is None else base
    _check_new_robot(plant, model_instance, base, parser)
    if plant.time_step() != on_grid(options.time_step):
        options = DrakeOptions.from_dict({**options.to_dict(), "time_step": decimal(plant.time_step())})
    limit = platform_damping_limit(robot, options)
    if options.platform_joint_damping > limit:
        allowed = f"at most {limit:.3g} N m s/rad for this robot at a time step of {options.time_step:g} s"
        raise ConfigurationError("plant.platform_joint_damping", options.platform_joint_damping, allowed)
    with drake_guard("adding the robot"):
        others = set(plant.GetConstraintIds())
        at = None if base.IsExactlyIdentity() else (base.translation(), base.rotation().ToRollPitchYaw().vector())
        joint, collides = options.rod_joint, options.collision
        text = sdf_text(robot, rod_joint=joint, collision=collides, joint_swing=None, name=model_instance, base=at)
        (instance,) = (Parser(plant) if parser is None else parser).AddModelsFromString(text, "sdf")
        added = StewartRobot(plant, instance, robot, options, base)
        # The coordinates of this joint are pose and twist in B, wherever the base is.
        floating = QuaternionFloatingJoint("platform", added.frame("base"), added.frame("platform"))
        home = RollPitchYaw(robot.home_pose[:3]).ToRotationMatrix()
        plant.AddJoint(floating).SetDefaultPose(RigidTransform(home, robot.home_pose[3:]))
        law = options.friction_of(robot)
        _add_damping(added, law["viscous"][0])
        add_servos(added, law)
        if law["break_away"].any():
            _ask_for_friction(plant, instance)
        if options.broken_rod is not None and options.break_step is not None:
            closures = [closure for closure in plant.GetConstraintIds() if closure not in others]
            _break(plant, closures[options.broken_rod.leg], options.break_step * plant.time_step())
        if options.payload_mass > 0.0:
            _add_payload(added)
    return added


def _check_new_robot(plant: MultibodyPlant, name: str, base: RigidTransform, parser: Parser | None) -> None:
    """Refuses a plant that cannot take another robot, and a wrong parser."""
    if parser is not None and parser.plant() is not plant:
        raise ConfigurationError("parser", parser, "a parser of this plant")
    if not np.isfinite(base.GetAsMatrix34()).all():
        raise ConfigurationError("base", base, "a place that is finite")
    if plant.is_finalized():
        raise ConfigurationError("plant", "a finalised one", "one before Finalize()")
    if plant.time_step() <= 0.0:
        raise ConfigurationError("plant", "a continuous one", "a discrete one, which ball constraints need")
    if plant.HasModelInstanceNamed(name):
        raise ConfigurationError("model_instance", name, "a name that the plant does not have yet")


def _add_payload(added: StewartRobot) -> None:
    """Adds the payload as a separate body, so that the platform keeps the mass of `RobotParameters` and the SDF."""
    plant, options = added.plant, added.options
    point = SpatialInertia(options.payload_mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
    payload = plant.AddRigidBody("payload", added.instance, point)
    place = RigidTransform(np.array(options.payload_position))
    plant.WeldFrames(added.frame("platform"), payload.body_frame(), place)


@checked
def add_plant(
    builder: DiagramBuilder,
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: Gravity = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
    before_finalize: Callable[[StewartRobot], None] | None = None,
    name: str = "plant",
    ball: BallOptions | None = None,
) -> StewartRobot:
    """Adds a finished plant with the robot to a Diagram under construction: `add_robot`, its friction, a SceneGraph.

    Its default state is the home pose at rest.

    Args:
        builder: Receives the system `plant`, and as needed `scene_graph`, `friction` and its `friction_...`.
        robot: Geometry and masses.
        options: Options of the plant; None takes the defaults.
        gravity: [m/s^2] a number, along -z; or a vector.
        visuals: Register the geometry with a SceneGraph even where nothing collides, for visualisers and cameras.
        before_finalize: Adds further bodies to the `plant` of the robot that it is called with.
        name: Of the plant in the Diagram.
        ball: A ball on the platform.

    Raises:
        ConfigurationError: Gravity, or a name, that the plant cannot have; see `add_robot`.
        DrakeCheckError: Drake refuses the model.
    """
    options = DrakeOptions() if options is None else options
    check_gravity(gravity)
    if builder.HasSubsystemNamed(name):
        raise ConfigurationError("name", name, "one that no other system of the Diagram has")
    with drake_guard("building the plant"):
        plant = MultibodyPlant(on_grid(options.time_step))
        plant.set_name(name)
        # With sampled outputs the plant steps in an unrestricted update, which copies all states.
        plant.SetUseSampledOutputPorts(False)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.set_contact_model(ContactModel.kPoint)
        scene_graph: SceneGraph | None = None
        if visuals or options.collision or ball is not None:
            _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
        else:
            builder.AddSystem(plant)
        plant.mutable_gravity_field().set_gravity_vector(gravity_vector(gravity))
    added = add_robot(plant, robot, options)
    added.scene_graph, added.ball = scene_graph, None if ball is None else BallBody(added, ball)
    if before_finalize is not None:
        before_finalize(added)
    with drake_guard("building the plant"):
        plant.Finalize()
        added.connect_friction(builder)
    return added


def build_plant(
    robot: RobotParameters,
    options: DrakeOptions | None = None,
    gravity: Gravity = STANDARD_GRAVITY,
    *,
    visuals: bool = False,
    ball: BallOptions | None = None,
) -> tuple[Diagram, StewartRobot]:
    """A Diagram with only `add_plant`, whose ports are exported as `torque` and `state`."""
    builder = DiagramBuilder()
    stewart = add_plant(builder, robot, options, gravity, visuals=visuals, ball=ball)
    with drake_guard("building the plant"):
        builder.ExportInput(stewart.torque_input_port, "torque")
        builder.ExportOutput(stewart.state_output_port, "state")
        return builder.Build(), stewart


def _break(plant: MultibodyPlant, closure: MultibodyConstraintId, time: float) -> None:
    """Disconnects a rod from the platform at a time [s], in every Context that reaches it or begins later."""
    # An event that refers to the plant would keep it alive.
    reference = weakref.ref(plant)

    def set_closed(context: Context, _: State) -> None:
        cast(MultibodyPlant, reference()).SetConstraintActiveStatus(context, closure, context.get_time() < time)

    plant.DeclareInitializationUnrestrictedUpdateEvent(set_closed)
    plant.DeclarePeriodicUnrestrictedUpdateEvent(_ONCE, time, set_closed)


def _ask_for_friction(plant: MultibodyPlant, instance: ModelInstanceIndex) -> None:
    """Raises at `Simulator.Initialize` if motors with stiction are not connected: Drake would let them slide."""
    reference = weakref.ref(plant)

    def ask(context: Context, _: State) -> None:
        if not cast(MultibodyPlant, reference()).get_desired_state_input_port(instance).HasValue(context):
            raise ConfigurationError("friction", "motors that stick", "a call of connect_friction(builder) first")

    plant.DeclareInitializationUnrestrictedUpdateEvent(ask)


def _add_damping(added: StewartRobot, viscous: np.ndarray) -> None:
    """Adds damping to the tree's joints, implicit in SAP, and to the loop closures, which are not joints.

    At a closure a bushing without stiffness damps the rates of the platform's roll, pitch, yaw in the rod, zero at
    home. It is explicit, and `MultibodyPlant.CalcPotentialEnergy` raises on such a plant.
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
