"""Friction that sticks on the motors of a plant, which Drake's joints lack: servos on the anchors of bristles.

A second actuator on each motor pulls its crank towards the anchor. SAP takes such a servo implicitly and cuts it at the
actuator's effort limit, break-away. That limit is settled before `Finalize`, and the level in sliding lies below it:
the rest of the way, `relief`, is added as a plain force and taken off the servo before the cut, so that in the
direction of the slip the two together pull as the bristle does, down to the level and no further.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.primitives import LinearSystem, MatrixGain, Multiplexer

from stewart_drake.jit import njit, record
from stewart_drake.mechanics.friction import drag_anchors, level
from stewart_drake.mechanics.linear_algebra import copy_to
from stewart_drake.robot.leg import LEGS

Relax = Callable[[Context, np.ndarray], None]
"""Takes the tension off in a Context of the whole Diagram, at a state (nq + nv,) of the plant."""


class MotorFriction(LeafSystem):
    """What friction asks of the servos, see `mechanics.friction`; what it remembers comes in from outside.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        bristles: in (12,), anchors [rad] and their speeds [rad/s] at the beginning of the plant's last step.
        pull: out (18,), anchors [rad], their speeds [rad/s] and relief [N m], until the plant's next step.

    """

    def __init__(self, plant: MultibodyPlant, friction: np.ndarray) -> None:
        super().__init__()
        self._friction, self._step = friction, plant.time_step()
        joints = [plant.GetJointByName(f"motor_{leg}") for leg in range(LEGS)]
        self.cranks = np.array([joint.position_start() for joint in joints])
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.bristles = self.DeclareVectorInputPort("bristles", 2 * LEGS)
        inputs = {self.all_input_ports_ticket()}
        self.pull = self.DeclareVectorOutputPort("pull", 3 * LEGS, self._calc, prerequisites_of_calc=inputs)

    def _calc(self, context: Context, output: Any) -> None:
        state, before = self.plant_state.Eval(context), self.bristles.Eval(context)
        _pull(self._friction, before, state, self.cranks, self._step, output.get_mutable_value())


@njit
def _pull(frictions: Any, before: Any, state: Any, cranks: Any, step: float, out: Any) -> None:
    """Anchors, slips and relief (18,) of those before (12,) and the state after a step.

    Relief is the torques that take friction's from break-away to its level, along the slips.
    """
    friction = record(frictions)
    copy_to(out[:12], before)
    drag_anchors(friction, state[cranks], step, out[:6], out[6:12])
    for i in range(6):
        slip = out[6 + i]
        out[12 + i] = np.sign(slip) * (friction.break_away[i] - level(friction, i, slip))


def add_friction_actuators(plant: MultibodyPlant, law: np.ndarray) -> None:
    """Adds the servos, before the plant is finalised; of motors without dry friction none."""
    for leg in _with_friction(law):
        joint = plant.GetJointByName(f"motor_{leg}")
        actuator = plant.AddJointActuator(f"friction_{leg}", joint, law["break_away"][0, leg])
        # Drake takes the rotor of a joint from its last actuator alone.
        actuator.set_default_rotor_inertia(plant.GetJointActuatorByName(f"motor_{leg}").default_rotor_inertia())
        actuator.set_controller_gains(PdControllerGains(p=law["stiffness"][0, leg], d=law["damping"][0, leg]))


def wire_friction(builder: DiagramBuilder, plant: MultibodyPlant, law: np.ndarray) -> tuple[InputPort, Relax]:
    """Feeds motors and servos of a finalised plant; gives the port of torques (6,), and what takes the tension off."""
    # What is remembered is stored by a system of Drake's: an update in Python right after the plant's step is slow.
    held, pulled = 2 * LEGS, 3 * LEGS
    store = LinearSystem(
        A=np.zeros((held, held)), B=np.eye(held, pulled), C=np.eye(held), D=[], time_period=plant.time_step()
    )
    memory = builder.AddNamedSystem("friction_memory", store)
    friction = builder.AddNamedSystem("friction", MotorFriction(plant, law))
    builder.Connect(plant.get_state_output_port(), friction.plant_state)
    builder.Connect(memory.get_output_port(), friction.bristles)
    builder.Connect(friction.pull, memory.get_input_port())
    home = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    memory.configure_default_state(_at_rest(home[friction.cranks]))
    actuators = plant.num_actuators()
    torque, desired = np.zeros((actuators, 4 * LEGS)), np.zeros((2 * actuators, 3 * LEGS))
    force = np.zeros((plant.num_velocities(), 3 * LEGS))
    for leg in range(LEGS):
        torque[plant.GetJointActuatorByName(f"motor_{leg}").input_start(), leg] = 1.0
        force[plant.GetJointByName(f"motor_{leg}").velocity_start(), 2 * LEGS + leg] = 1.0
    for leg in _with_friction(law):
        servo = plant.GetJointActuatorByName(f"friction_{leg}").input_start()
        torque[servo, 3 * LEGS + leg], desired[servo, leg] = -1.0, 1.0
    both = builder.AddNamedSystem("friction_inputs", Multiplexer([LEGS, 3 * LEGS]))
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

    def relax(context: Context, state: np.ndarray) -> None:
        memory.GetMyMutableContextFromRoot(context).SetDiscreteState(_at_rest(state[friction.cranks]))

    port: InputPort = both.get_input_port(0)
    return port, relax


def _with_friction(law: np.ndarray) -> list[int]:
    return [leg for leg in range(LEGS) if law["break_away"][0, leg] > 0.0]


def _at_rest(angles: np.ndarray) -> np.ndarray:
    """Anchors and slips (12,) without tension at crank angles (6,) [rad]."""
    return np.concatenate([angles, np.zeros(LEGS)])
