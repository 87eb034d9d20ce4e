"""Stiction of motors in a `MultibodyPlant`: servos, and the systems of a Diagram that drive them.

Every motor has a second actuator, a servo that pulls its crank towards the anchor of the bristle, implicitly; its
effort limit is the break-away torque. The level in sliding is lower. The difference, the Stribeck torque, is added as
an external force and subtracted from the servo's torque before the limit, so that both give the bristle's torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPort, LeafSystem, OutputPort, System
from pydrake.systems.primitives import Adder, LinearSystem, MatrixGain, Multiplexer

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Vec12, Vec18, Vector, record
from stewart_drake.mechanics.friction import Friction, level, update_bristles
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.plant.context_parameters import WithParameters
from stewart_drake.robot.leg import LEG_COUNT

if TYPE_CHECKING:
    from stewart_drake.plant.multibody_plant import StewartRobot


class FrictionSystems(NamedTuple):
    """The systems of motors with stiction."""

    torque: InputPort  # (6,) [N m]
    memory: LinearSystem  # Anchors and slips.
    cranks: np.ndarray  # (6,) places of the cranks' angles in a state of the plant.

    def relaxed(self, state: np.ndarray) -> np.ndarray:
        """Memory (12,) of relaxed bristles in a state of the plant."""
        return np.append(state[self.cranks], np.zeros(LEG_COUNT))


class MotorFriction(LeafSystem, WithParameters):
    """Inputs of the servos from `plant_state` and `bristles` (12,): anchors [rad] and slips [rad/s] before the step.

    The output `pull` (18,) has anchors, slips and Stribeck torques [N m] until the next step. The parameter `friction`
    is a `Friction` record; break_away and viscous have their effect in the plant, as a motor's limit and damping.
    """

    def __init__(self, robot: StewartRobot, friction: Friction) -> None:
        super().__init__()
        plant = robot.plant
        self._step, self.cranks = plant.time_step(), robot.indices.crank
        self._friction = self.declare_parameters({"friction": friction})["friction"]
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.bristles = self.DeclareVectorInputPort("bristles", 2 * LEG_COUNT)
        needs = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.pull = self.DeclareVectorOutputPort("pull", 3 * LEG_COUNT, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state, before = self.plant_state.Eval(context), self.bristles.Eval(context)
        self.read_parameters(context)
        _servo_inputs(self._friction, before, state, self.cranks, self._step, output.get_mutable_value())


@njit
def _servo_inputs(friction: Friction, before: Vec12, state: Vector, cranks: Vector, step: float, out: Vec18) -> None:
    """Anchors, slips and Stribeck torques from anchors and slips before, and the cranks in the state of the plant."""
    friction, angles = record(friction), np.empty(6)
    for i in range(6):
        angles[i] = state[cranks[i]]
    copy_to(out[:12], before)
    update_bristles(friction, angles, step, out[:6], out[6:12])
    for i in range(6):
        slip = out[6 + i]
        out[12 + i] = np.sign(slip) * (friction.break_away[i] - level(friction, i, slip))


def add_servos(added: StewartRobot, law: Friction) -> None:
    """Adds a servo for every motor with dry friction; before the plant is finalised."""
    plant = added.plant
    for leg in np.flatnonzero(law["break_away"][0]).tolist():
        actuator = plant.AddJointActuator(f"friction_{leg}", added.joint(f"motor_{leg}"), law["break_away"][0, leg])
        # Drake takes the rotor's inertia from the last actuator of a joint.
        motor = plant.GetJointActuatorByName(f"motor_{leg}", added.instance)
        actuator.set_default_rotor_inertia(motor.default_rotor_inertia())
        stiffness = law["stiffness"][0, leg]
        actuator.set_controller_gains(PdControllerGains(p=stiffness, d=stiffness * plant.time_step()))


def wire_friction(builder: DiagramBuilder, robot: StewartRobot, law: Friction) -> FrictionSystems:
    """Connects motors and servos of a finalised plant."""
    plant, instance = robot.plant, robot.instance
    model = plant.GetModelInstanceName(instance)
    prefix = "friction" if model == "stewart" else f"{model}_friction"
    # The memory is a system of Drake's: an update in Python right after the plant's step is slow.
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
        # An unconnected desired state would silently disarm the servos.
        ("anchor", desired, friction.pull, plant.get_desired_state_input_port(instance)),
        ("relief", force, friction.pull, plant.get_applied_generalized_force_input_port()),
    ):
        gain = builder.AddNamedSystem(f"{prefix}_{name}", MatrixGain(matrix))
        builder.Connect(source, gain.get_input_port())
        connect_besides(builder, gain.get_output_port(), target, Adder(2, len(matrix)))

    systems = FrictionSystems(both.get_input_port(0), memory, friction.cranks)
    memory.configure_default_state(systems.relaxed(robot.default))
    return systems


def connect_besides(builder: DiagramBuilder, source: OutputPort, target: InputPort, both: System) -> None:
    """Connects a port; `both` adds the signal to the one that is connected already."""
    if before := builder.connection_map().get((target.get_system(), target.get_index())):
        other = before[0].get_output_port(before[1])
        builder.AddSystem(both)
        builder.Disconnect(other, target)
        builder.Connect(other, both.get_input_port(0))
        builder.Connect(source, both.get_input_port(1))
        source = both.get_output_port()
    builder.Connect(source, target)
