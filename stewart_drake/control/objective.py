"""What control is for, in one number: small errors, and torques that do not shake."""

from __future__ import annotations

from typing import Any

from stewart_drake.config import Positive, Section


class CostScales(Section, key="cost"):
    """What counts as one in the cost of a run."""

    rotation: Positive = 0.03
    """[deg] of the error's RMS length."""
    position: Positive = 0.03
    """[mm] likewise."""
    torque_change: Positive = 0.03
    """[N m] RMS change of a motor's torque in a millisecond."""

    def at(self, kappa: float) -> CostScales:
        """The scales by taste, from stiff, kappa = -1, to quiet, 1: the last one divided by 10^kappa."""
        return CostScales(
            rotation=self.rotation, position=self.position, torque_change=self.torque_change * 10.0**-kappa
        )


def cost(rotation: Any, position: Any, torque_change: Any, scales: CostScales) -> Any:
    """J = sqrt((rotation / its scale)^2 + (position / its scale)^2 + (torque_change / its scale)^2) [-].

    Takes numbers, or arrays of any shape: RMS length of the error [deg] and [mm], RMS change of a motor's torque in a
    millisecond [N m].
    """
    squares = (rotation / scales.rotation) ** 2 + (position / scales.position) ** 2
    return (squares + (torque_change / scales.torque_change) ** 2) ** 0.5
