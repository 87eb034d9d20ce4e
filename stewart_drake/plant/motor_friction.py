"""Friction that sticks on the motors of a plant, which Drake's joints lack: servos on the anchors of bristles.

A second actuator on each motor pulls its crank towards the anchor. SAP takes such a servo implicitly and cuts it at the
actuator's effort limit, break-away. That limit is settled before `Finalize`, and the level in sliding lies below it:
the rest of the way, `relief`, is added as a plain force and taken off the servo before the cut, so that in the
direction of the slip the two together pull as the bristle does, down to the level and no further.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, InputPort, LeafSystem
from pydrake.systems.primitives import MatrixGain, Multiplexer

from stewart_drake.mechanics.friction import Bristles, FrictionLaw, at_rest, level, moved
from stewart_drake.robot.leg import LEGS


class MotorFriction(LeafSystem):
    """Anchors of the motors' bristles, see `mechanics.friction`; the the state lives in the Context.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        pull: out (18,), anchors [rad], their speeds [rad/s] and relief [N m], until the plant's next step; the state.

    Args:
        plant: Finalised, with the actuators that `add_friction_actuators` adds.
        law: Of the motors.
    """

    def __init__(self, plant: MultibodyPlant, law: FrictionLaw) -> None:
        super().__init__()
        self._law, self._step = law, plant.time_step()
        joints = [plant.GetJointByName(f"motor_{leg}") for leg in range(LEGS)]
        self._angles = np.array([joint.position_start() for joint in joints])
        state = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
        self.DeclareDiscreteState(self._relaxed(state))
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.pull = self.DeclareVectorOutputPort("pull", 3 * LEGS, self._calc)
        self.DeclarePeriodicDiscreteUpdateEvent(self._step, 0.0, self._store)

    def relax(self, context: Context, state: np.ndarray) -> None:
        """Takes the tension off at a state (nq + nv,) of the plant.

        Args:
            context: Of the whole Diagram.
            state: Where the plant is put.
        """
        mine = self.GetMyMutableContextFromRoot(context)
        mine.SetDiscreteState(self._relaxed(state))

    def _relaxed(self, state: np.ndarray) -> np.ndarray:
        return np.concatenate([*at_rest(state[self._angles]), np.zeros(LEGS)])

    def _calc(self, context: Context, output: Any) -> None:
        # Between two events the memory is that of the step's beginning and the angles those of its end.
        memory = context.get_discrete_state(0).value()
        angles = self.plant_state.Eval(context)[self._angles]
        now = moved(self._law, Bristles(memory[:LEGS], memory[LEGS : 2 * LEGS]), angles, self._step)
        relief = np.sign(now.slip) * (self._law.break_away - level(self._law, now.slip))
        output.SetFromVector(np.concatenate([*now, relief]))

    def _store(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(0, self.pull.Eval(context))


def add_friction_actuators(plant: MultibodyPlant, law: FrictionLaw) -> None:
    """Adds the servos, before the plant is finalised; of motors without dry friction none."""
    for leg in _with_friction(law):
        joint = plant.GetJointByName(f"motor_{leg}")
        actuator = plant.AddJointActuator(f"friction_{leg}", joint, law.break_away[leg])
        # Drake takes the rotor of a joint from its last actuator alone.
        actuator.set_default_rotor_inertia(plant.GetJointActuatorByName(f"motor_{leg}").default_rotor_inertia())
        actuator.set_controller_gains(PdControllerGains(p=law.stiffness[leg], d=law.damping[leg]))


def wire_friction(builder: DiagramBuilder, plant: MultibodyPlant, law: FrictionLaw) -> tuple[InputPort, MotorFriction]:
    """Feeds motors and servos of a finalised plant.

    Returns:
        Port for the motors' torques (6,), and what pulls at the cranks.
    """
    friction = builder.AddNamedSystem("friction", MotorFriction(plant, law))
    builder.Connect(plant.get_state_output_port(), friction.plant_state)
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
    port: InputPort = both.get_input_port(0)
    return port, friction


def _with_friction(law: FrictionLaw) -> list[int]:
    return [leg for leg in range(LEGS) if law.break_away[leg] > 0.0]
