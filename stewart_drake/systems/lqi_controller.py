"""The LQI as a LeafSystem."""

from __future__ import annotations

from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.part_system import PartSystem


class LqiController(PartSystem):
    """Linear quadratic integral regulator, (19)-(34): a new gain at every tick, from that tick's pose and weights.

    The torque answers within the tick (no added delay) and is held until the next; see `PartSystem`. z, and what
    bridges a failed tick, live in the Context. The gain comes from Drake's `DiscreteAlgebraicRiccatiEquation`, or with
    `solver: split` from the compiled split solution.

    Args:
        robot: As the controller believes it to be.
        options: See `LqiOptions`.
        gravity: [m/s^2].
        weights: Size of the port: 2, or 4 for block weights.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        weights: in (2,), omega_Q, omega_R, or (4,), q_e, q_v, q_z, r; all > 0.
        torque: out (6,) [N m], within the motors' limits where `saturation` says so.
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    measurement: InputPort
    reference: InputPort
    weights: InputPort
    torque: OutputPort
    error: OutputPort
    integral: OutputPort

    def __init__(self, robot: RobotParameters, options: LqiOptions, gravity: float, weights: int = 2) -> None:
        if weights not in (2, 4):
            raise ConfigurationError("weights", weights, "2 or 4")
        super().__init__(lqi_part(options, robot, gravity, weights), options.period)
