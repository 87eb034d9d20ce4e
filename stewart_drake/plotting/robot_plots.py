"""A robot's legs at home, with numbers and turning directions, so that a wrong crank is seen."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.plotting import style as look
from stewart_drake.robot import RobotParameters

_ARC = np.radians(np.linspace(-40.0, 40.0, 41))  # About the crank's angle.
_FLAT = 1e-6  # Of cranks that turn in a horizontal plane.
_ARROW = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "lw": 2.0}


@look.styled
def plot_robot(robot: RobotParameters, path: str | Path) -> None:
    """From above, and every leg in the plane of its crank, which is where the crank turns."""
    legs = leg_geometry(robot, robot.home_pose)
    shafts, joints = 1e3 * robot.shaft_positions, 1e3 * (robot.joints_in_platform + [0.0, 0.0, robot.home_height])
    tips = shafts + 1e3 * robot.crank_lengths[:, None] * legs.crank
    figure, ((plan, side),) = look.panels(1, 2, 5.2, 13.0, width_ratios=[1.0, 1.5])
    _draw_plan(plan, shafts, tips, joints, robot)
    arms = np.stack([_in_plane(robot, points - shafts) for points in (tips, joints)])
    step = max(1.25 * float(np.ptp(arms[..., 0])), 2.7e3 * float(robot.crank_lengths.max()))
    for leg, angle in enumerate(legs.crank_angles):
        at = np.array([step * leg, shafts[leg, 2]])
        tip, joint = at + arms[:, leg]
        radius = 1.25e3 * robot.crank_lengths[leg]
        up = float(robot.crank_quarter_directions[leg, 2])
        arc = at + radius * np.stack([np.cos(angle + _ARC), math.copysign(1.0, up) * np.sin(angle + _ARC)], axis=-1)
        side.plot(*np.stack([at - [radius, 0.0], at + [radius, 0.0]]).T, color=look.GREY, lw=0.8, ls=":")
        side.plot(*np.stack([tip, joint]).T, color=look.GREY, lw=2.0)
        side.plot(*arc.T, color=look.BLUE, lw=1.2)
        side.annotate("", arc[-1], arc[-3], arrowprops={**_ARROW, "color": look.BLUE})
        side.annotate("", tip, at, arrowprops={**_ARROW, "color": look.ORANGE})
        side.plot(*at, "s", color=look.BLUE)
        side.plot(*joint, "o", color=look.GREEN)
        note = f"leg {leg}\n{round(math.degrees(angle), 1) + 0.0:.1f} deg"
        side.annotate(note, (at[0], 0.0), (0, 10), ("data", "axes fraction"), textcoords="offset points", ha="center")
    side.set(title="Every leg in its crank's plane: angle at home, arrow to larger angles", ylabel="z [mm]", xticks=[])
    side.set_aspect("equal", adjustable="datalim")
    look.legend_below(figure, plan.get_legend_handles_labels()[0])
    look.save_figure(figure, path)


def _in_plane(robot: RobotParameters, arms: np.ndarray) -> np.ndarray:
    """(6, 2) [mm] along the level crank, and up."""
    up = robot.crank_quarter_directions * np.sign(robot.crank_quarter_directions[:, 2:] + 1e-12)
    return np.stack([np.sum(arms * robot.crank_zero_directions, axis=-1), np.sum(arms * up, axis=-1)], axis=-1)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def _draw_plan(plan: Axes, shafts: np.ndarray, tips: np.ndarray, joints: np.ndarray, robot: RobotParameters) -> None:
    around = joints[np.argsort(np.arctan2(*joints[:, 1::-1].T))]
    plan.fill(*around[:, :2].T, color=look.SKY, alpha=0.3)
    for leg in range(len(shafts)):
        plan.plot(*np.stack([tips[leg], joints[leg]])[:, :2].T, color=look.GREY, lw=2.0)
        plan.annotate("", tuple(tips[leg, :2]), tuple(shafts[leg, :2]), arrowprops={**_ARROW, "color": look.ORANGE})
        # Beside the crank, and further out than the partner's number.
        free = _unit(0.6 * _unit(shafts[leg, :2]) - _unit(tips[leg, :2] - shafts[leg, :2]))
        place = shafts[leg, :2] + 0.1 * np.linalg.norm(shafts[leg, :2]) * free
        plan.annotate(str(leg), tuple(place), ha="center", va="center", fontsize=12, weight="bold")
    up = robot.crank_quarter_directions[:, 2]
    for marker, which, text in (("^", up > _FLAT, "raises"), ("v", up < -_FLAT, "lowers")):
        if which.any():
            plan.plot(
                *tips[which, :2].T, marker, color=look.ORANGE, ms=8, ls="", label=f"a larger angle {text} the crank"
            )
    plan.plot(*shafts[:, :2].T, "s", color=look.BLUE, label="motor shaft")
    plan.plot(*joints[:, :2].T, "o", color=look.GREEN, label="platform joint")
    plan.set(title="From above, at home", xlabel="x [mm]", ylabel="y [mm]")
    plan.set_aspect("equal")
    plan.margins(0.15)
