"""Plant and observer of many loops at once: `closed_chain.advanced` and `observer.observe` on the array core, in torch.

Vectors are (6, B), components first, as in `kinematics_core`; matrices for linear algebra are (B, 6, 6).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from stewart_drake.hardware.observer import ARRIVED, RESTS
from stewart_drake.hardware.observing import observer_at
from stewart_drake.hardware.sensing import LoopSite
from stewart_drake.mechanics import dynamics_core, kinematics_core
from stewart_drake.mechanics.arrays import Robot, cross, fitted, namespace, robot_like
from stewart_drake.mechanics.friction import Bristles, FrictionLaw, Motor, implicit_torque, moved
from stewart_drake.mechanics.kinematics import roll_pitch_yaw
from stewart_drake.mechanics.kinematics_core import Legs
from stewart_drake.plant.closed_chain import loaded
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario
from stewart_drake.training.gains import kalman_gains, product

SETTLED = 1e-12
"""[N m] by which torques of friction may be off."""
_STEPS = 12
"""Of Newton's method for them; four to seven do."""


class Chain(NamedTuple):
    """The closed chain of each loop at a pose.

    Attributes:
        legs: See `kinematics_core.legs_at`.
        jacobian: (6 twist, 6 legs, B) d(theta)/d(twist).
        inertia: (B, 6, 6).
    """

    legs: Legs
    jacobian: Tensor
    inertia: Tensor

    @classmethod
    def at(cls, robot: Robot, pose: Tensor) -> Chain:
        """At poses (6, B)."""
        legs = kinematics_core.legs_at(robot, pose.T)
        return cls(legs, kinematics_core.twist_jacobian(robot, legs), dynamics_core.task_inertia(robot, legs))

    @property
    def rows(self) -> Tensor:
        """(B, 6 legs, 6 twist) d(theta)/d(twist)."""
        return self.jacobian.permute(2, 1, 0)

    def load(self, robot: Robot, motion: Tensor, torque: Tensor, gravity: float) -> Tensor:
        """(6, B) what torques (6, B) leave to accelerate the platform at twists (6, B)."""
        wrench, own = dynamics_core.loads(robot, self.legs, motion, None, gravity, True)
        return (self.jacobian * (torque - own)).sum(dim=1) - wrench


def solved(matrix: Tensor, right: Tensor) -> Tensor:
    """Solutions (n, B) of systems (B, 6, 6) with right sides (n, B)."""
    return torch.linalg.solve_ex(matrix, right.T[..., None])[0][..., 0].T


class PlantState(NamedTuple):
    """Of `closed_chain.ChainState`, (6, B) each: cranks and bristles as they were when the pose was last looked at.

    Attributes:
        pose: [rad, m].
        twist: [rad/s, m/s].
        angles: [rad] of the cranks, not wrapped.
        anchor: [rad] of the bristles.
        slip: [rad/s] of the anchors.
    """

    pose: Tensor
    twist: Tensor
    angles: Tensor
    anchor: Tensor
    slip: Tensor


class Plant(NamedTuple):
    """What stays the same from step to step.

    Attributes:
        robot: As it is, payload included.
        law: Of friction, (B, 6); None without.
        gravity: [m/s^2].
        step: [s].
        width: (B, 6) [N m] by which friction's corners are rounded; 0.0 for not.
    """

    robot: Robot
    law: FrictionLaw | None
    gravity: float
    step: float
    width: Tensor | float

    @classmethod
    def of(cls, scenarios: Sequence[Scenario], width: float, tensor: Callable[[Any], Tensor]) -> Plant:
        """That of some scenarios, with friction's corners rounded by a share `width` of the break-away torque."""
        robot, options = scenarios[0].robot, [scenario.plant for scenario in scenarios]
        fixed = fitted(robot_like(robot, tensor(0.0)), 1)
        if any(each.payload_mass > 0.0 for each in options):
            own = [loaded(robot, each) for each in options]
            names = ("platform_mass", "platform_moment", "platform_inertia")
            fixed = fixed._replace(
                **{name: tensor(np.stack([getattr(each, name) for each in own], axis=-1)) for name in names}
            )
        laws = zip(*(each.friction_law(robot) for each in options), strict=True)
        law = FrictionLaw(*(tensor(np.stack(each, axis=-1)).T for each in laws))
        rubs = bool((law.break_away > 0.0).any() or (law.viscous > 0.0).any())
        rounded = width * law.break_away if width > 0.0 else 0.0
        step = on_grid(options[0].time_step)
        return cls(fixed, law if rubs else None, scenarios[0].gravity, step, rounded)

    def arrived(self, state: PlantState) -> tuple[PlantState, Legs]:
        """Cranks and bristles brought to where the pose is."""
        legs = kinematics_core.legs_at(self.robot, state.pose.T)
        ahead = torch.atan2(legs.cranks.sine, legs.cranks.cosine) - state.angles
        angles = state.angles + ahead - (2.0 * math.pi) * torch.round(ahead / (2.0 * math.pi))
        state = state._replace(angles=angles)
        if self.law is not None:
            bristles = Bristles(state.anchor.T, state.slip.T)
            anchor, slip = moved(self.law, bristles, angles.T, self.step, self.width)
            state = state._replace(anchor=anchor.T, slip=slip.T)
        return state, legs

    def chain(self, legs: Legs) -> Chain:
        """The chain at a pose that has been looked at."""
        jacobian = kinematics_core.twist_jacobian(self.robot, legs)
        return Chain(legs, jacobian, dynamics_core.task_inertia(self.robot, legs))

    def pushed(self, state: PlantState, chain: Chain, torque: Tensor, wrench: Tensor | None) -> PlantState:
        """A step of a state that has `arrived`, but for cranks and bristles."""
        load = chain.load(self.robot, state.twist, torque, self.gravity)
        if wrench is not None:
            load = load + wrench
        if self.law is None:
            twist = state.twist + self.step * solved(chain.inertia, load)
        else:
            rows = chain.rows
            both = torch.cat([rows.mT, load.T[..., None]], dim=-1)
            both = torch.linalg.solve_ex(chain.inertia, both)[0].permute(1, 2, 0).contiguous()
            free, pushed = state.twist + self.step * both[:, 6], both[:, :6]
            bristles = Bristles(state.anchor.T, state.slip.T)
            rates = (chain.jacobian * free[:, None]).sum(dim=0)
            mobility = product(chain.jacobian.transpose(0, 1), pushed).permute(2, 0, 1)
            dry = friction_torque(self.law, bristles, state.angles.T, rates.T, mobility, self.step, self.width)
            twist = free + self.step * (pushed * dry.T).sum(dim=1)
        half = (0.5 * self.step) * twist[:3]
        scale = 2.0 / (1.0 + (half * half).sum(dim=0))
        turn, half, xp = chain.legs.rotation, half[:, None], namespace(twist)
        turn = turn + scale * cross(xp, half, turn + cross(xp, half, turn))
        angles: Tensor = roll_pitch_yaw(turn.permute(2, 0, 1)).T  # type: ignore[assignment]
        place = state.pose[3:] + self.step * twist[3:]
        return state._replace(pose=torch.cat([angles, place]), twist=twist)


def friction_torque(
    law: FrictionLaw,
    bristles: Bristles,
    angles: Tensor,
    free_rates: Tensor,
    mobility: Tensor,
    step: float,
    width: Tensor | float,
) -> Tensor:
    """`friction.implicit_torque` for all motors at once, by Newton's method.

    With motors as they answer to the rates without them, found = answer(without(found)) is piecewise linear but for
    rounded corners: a few steps find its solution, where one motor after the other takes thirty. A gradient passes the
    last step alone, which is the implicit function theorem. Loops that do not settle are left to the sweeps.
    """
    pushed = step * mobility
    own = torch.diagonal(pushed, dim1=-2, dim2=-1)
    motors = Motor.of(law, bristles, angles, own, step, width)
    others = pushed - torch.diag_embed(own)
    unit = torch.eye(6, dtype=own.dtype, device=own.device)

    def better(found: Tensor) -> tuple[Tensor, Tensor]:
        without = free_rates + torch.matmul(others, found[..., None])[..., 0]
        answer = motors.answer(without)
        with torch.no_grad():
            matrix = unit - motors.slope(without)[..., None] * others
        off = answer - found
        return found + torch.linalg.solve_ex(matrix, off[..., None])[0][..., 0], off

    with torch.no_grad():
        found = torch.zeros_like(free_rates)
        for _ in range(_STEPS):
            found, off = better(found)
            if bool(off.abs().amax() < SETTLED):
                break
        else:
            found = implicit_torque(law, bristles, angles, free_rates, mobility, step, width, tolerance=SETTLED)
    return better(found.detach())[0] if torch.is_grad_enabled() else found


class ObserverState(NamedTuple):
    """Of `observer.ObserverMemory`, (6, B) each.

    Attributes:
        pose: [rad, m] as believed now.
        rate: [rad/s, m/s] likewise.
        surplus: [rad/s^2] of the cranks, not explained.
        missed: [-] ticks in a row without a reading.
        innovation: [rad] of the last tick.
        expected_pose: [rad, m] at the next tick.
        expected_rate: [rad/s, m/s] likewise.
    """

    pose: Tensor
    rate: Tensor
    surplus: Tensor
    missed: Tensor
    innovation: Tensor
    expected_pose: Tensor
    expected_rate: Tensor


class BatchedObserver(NamedTuple):
    """What stays the same from tick to tick.

    Attributes:
        robot: As believed.
        gravity: [m/s^2].
        period: [s].
        noise: (B,) [rad] of a reading.
        slip: (B,) [rad/s^2] of a crank by the believed friction, see `observer.SLIP`; 0 without any.
        max_innovation: (B,) [rad].
        hold_ticks: (B,).
        ahead: (B,) ticks.
        groups: Of each step of looking ahead, the loops that take it; None for all.
    """

    robot: Robot
    gravity: float
    period: float
    noise: Tensor
    slip: Tensor
    max_innovation: Tensor
    hold_ticks: Tensor
    ahead: Tensor
    groups: tuple[Tensor | None, ...]

    @classmethod
    def of(
        cls, scenarios: Sequence[Scenario], sites: Sequence[LoopSite], robot: Robot, tensor: Callable[[Any], Tensor]
    ) -> BatchedObserver:
        """That of some scenarios, all of which have one."""
        options: list[Any] = [scenario.estimator for scenario in scenarios]
        given = zip(options, sites, scenarios, strict=True)
        placed = [observer_at(each, site, scenario.sensors) for each, site, scenario in given]
        own = [each.observer for each in placed]
        ahead = tensor([each.ahead for each in placed]).long()
        groups = [torch.nonzero(ahead > step)[:, 0] for step in range(max(each.ahead for each in placed))]
        return cls(
            robot,
            scenarios[0].gravity,
            own[0].period,
            tensor([each.reading_noise for each in own]),
            tensor([each.slip for each in own]),
            tensor([each.max_innovation for each in options]),
            tensor([each.hold_ticks for each in options]),
            ahead,
            tuple(None if len(group) == len(own) else group for group in groups),
        )

    def corrected(
        self, state: ObserverState, angles: Tensor, wanted: Tensor, disturbance: Tensor
    ) -> tuple[ObserverState, Tensor]:
        """The first half of `observer.observe`: a reading (6, B) and the reference (18, B) at that instant.

        Returns:
            The state but for what is expected, and (B,) whether it can go on.
        """
        pose, rate = state.expected_pose, state.expected_rate
        legs = kinematics_core.legs_at(self.robot, pose.T)
        expected = torch.atan2(legs.cranks.sine, legs.cranks.cosine)
        innovation = torch.remainder(angles - expected + math.pi, 2.0 * math.pi) - math.pi
        believed = innovation.abs() <= self.max_innovation
        missed = torch.where(believed, 0.0, state.missed + 1.0)
        innovation = torch.where(believed, innovation, 0.0)
        angle, speed, surplus = kalman_gains(self.noise, disturbance, self.period)
        jacobian = kinematics_core.twist_jacobian(self.robot, legs)
        turned = solved(jacobian.permute(2, 1, 0), innovation)
        turned = torch.cat([kinematics_core.euler_rates(pose.T, turned[:3]), turned[3:]])
        pose, rate = pose + angle * turned, rate + speed * turned
        off = kinematics_core.twist(pose.T, (pose - wanted[:6]).T)
        turning = kinematics_core.twist(pose.T, wanted[6:12].T)
        with torch.no_grad():
            turn = (disturbance / (self.noise * math.sqrt(self.period))) ** (1.0 / 3.0)
            arrived = torch.maximum(ARRIVED * self.noise, self.slip / (turn * turn))
            stands = ((jacobian * off[:, None]).sum(dim=0).abs() <= arrived).all(dim=0) & (self.slip > 0.0)
            stands &= ((jacobian * turning[:, None]).sum(dim=0).abs() <= RESTS).all(dim=0)
        grown = torch.where(stands, state.surplus, state.surplus + surplus * innovation)
        good = (missed <= self.hold_ticks).all(dim=0) & (legs.cranks.reach > 0.0).all(dim=0)
        return state._replace(pose=pose, rate=rate, surplus=grown, missed=missed, innovation=innovation), good

    def looked_ahead(self, state: ObserverState, sent: tuple[Tensor, ...]) -> tuple[ObserverState, Tensor, Tensor]:
        """Where the command of this tick will find the robot.

        Args:
            state: `corrected`.
            sent: (6, B) [N m] commands of the ticks before, oldest first, as many as the farthest looks ahead.

        Returns:
            The state with what is expected at the next tick, of loops that look ahead; pose and rate (6, B) then.
        """
        pose, rate = state.pose, state.rate
        for step, group in enumerate(self.groups):
            command = self._sent(sent, step)
            if group is None:
                pose, rate = self.advanced(pose, rate, command, state.surplus)
            else:
                some = (each.index_select(1, group) for each in (pose, rate, command, state.surplus))
                moved_pose, moved_rate = self.advanced(*some)
                pose, rate = pose.index_copy(1, group, moved_pose), rate.index_copy(1, group, moved_rate)
            if step == 0:
                state = state._replace(expected_pose=pose, expected_rate=rate)
        return state, pose, rate

    def expecting(self, state: ObserverState, sent: Tensor) -> ObserverState:
        """The state with what is expected of loops that do not look ahead, for this tick's command (6, B) [N m]."""
        if self.groups and self.groups[0] is None:
            return state
        group = torch.nonzero(self.ahead == 0)[:, 0]
        some = (each.index_select(1, group) for each in (state.pose, state.rate, sent, state.surplus))
        pose, rate = self.advanced(*some)
        if not self.groups:
            return state._replace(expected_pose=pose, expected_rate=rate)
        return state._replace(
            expected_pose=state.expected_pose.index_copy(1, group, pose),
            expected_rate=state.expected_rate.index_copy(1, group, rate),
        )

    def advanced(self, pose: Tensor, rate: Tensor, torque: Tensor, surplus: Tensor) -> tuple[Tensor, Tensor]:
        """`observer.advance`: pose and rate (6, n) a period later."""
        chain = Chain.at(self.robot, pose)
        motion = kinematics_core.twist(pose.T, rate.T)
        found = solved(chain.inertia, chain.load(self.robot, motion, torque, self.gravity))
        found = found + solved(chain.rows, surplus)
        angular = found[:3] - kinematics_core.angular_drift(pose.T, rate.T)
        acceleration = torch.cat([kinematics_core.euler_rates(pose.T, angular), found[3:]])
        return pose + self.period * (rate + (0.5 * self.period) * acceleration), rate + self.period * acceleration

    def _sent(self, sent: tuple[Tensor, ...], step: int) -> Tensor:
        """What acts in a step of looking ahead: with a ticks ahead, the command of a - step ticks ago."""
        index = (len(sent) - self.ahead + step).clamp(max=len(sent) - 1)
        if len(sent) == 1:
            return sent[0]
        return torch.stack(sent).gather(0, index.expand(1, 6, -1))[0]
