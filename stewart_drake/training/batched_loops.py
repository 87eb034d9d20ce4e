"""Whole closed loops by the thousand, in torch: plant, encoders, observer, LQI, delay, friction, pushes and tuner.

The order of events is that of `runs.reduced_run`, the mechanics are those of the array core, and what a run costs can
be differentiated by whatever chose its settings. A loop that fails stands still from then on and disturbs no other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from stewart_drake.control.objective import CostScales, cost
from stewart_drake.control.settings import disturbance_of, weights_of
from stewart_drake.hardware.estimator import EncoderOptions, estimate, initial_memory
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.hardware.sensing import LoopSite
from stewart_drake.logs.cost import FAILED
from stewart_drake.mechanics import kinematics_core
from stewart_drake.mechanics.arrays import fitted, robot_like
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.plant.closed_chain import starting_state
from stewart_drake.sampling import steps_per
from stewart_drake.scenario import Scenario
from stewart_drake.training.gains import Regulator, product
from stewart_drake.training.loop_model import BatchedObserver, Chain, ObserverState, Plant, PlantState, solved
from stewart_drake.training.loop_state import Costs, LoopState, Observed, Tuner, frozen, kept
from stewart_drake.training.loop_tables import LoopTables, Row, looked_ahead, refuse

_WILD = 1e4
"""[rad/s, m/s] beyond which a loop is lost, whatever else."""


class BatchedLoops:
    """Loops of one robot, one control period and one step of the plant; all else may differ.

    Args:
        scenarios: One a loop.
        device: Of all tensors; None for the CPU.
        width: [-] by which friction's corners are rounded, as a share of the break-away torque; 0 for sharp.

    Attributes:
        scenarios: As given.
        period: [s].
        base: (B, 4) block weights of the setting zero.

    Raises:
        ConfigurationError: See `loop_tables.refuse`.
        UnreachablePoseError: A reference, in the run, or a start out of reach.
    """

    def __init__(self, scenarios: Sequence[Scenario], device: Any = None, width: float = 0.0) -> None:
        refuse(scenarios)
        first = scenarios[0]
        self.scenarios, self.period, self._options = tuple(scenarios), first.controller.period, first.lqi
        self._device = torch.device("cpu" if device is None else device)
        self._steps = steps_per("controller.period", self.period, first.plant.time_step)
        sites = [LoopSite.of(scenario) for scenario in scenarios]
        like = self._tensor(0.0)
        self._believed = fitted(robot_like(first.believed_robot, like), 1)
        self._plant = Plant.of(scenarios, width, self._tensor)
        payload = any(scenario.plant.payload_mass > 0.0 for scenario in scenarios)
        self._shared = not payload and first.believed_robot == first.robot
        ahead = [looked_ahead(scenario) for scenario in scenarios]
        self._observer = None
        if isinstance(first.estimator, ObserverOptions):
            self._observer = BatchedObserver.of(scenarios, sites, self._believed, self._tensor)
        self._tables = LoopTables(scenarios, ahead, self._device)
        self._delay = torch.tensor([scenario.command_delay for scenario in scenarios], device=self._device)
        self._delays, self._aheads = [max(s.command_delay for s in scenarios)], [max(ahead)]
        self._still = self._tensor([site.still for site in sites]).T
        self._limit = self._tensor(first.believed_robot.effort_limits)[:, None]
        self._motor_limit = self._tensor(first.robot.effort_limits)[:, None]
        length = self._options.length
        self._scale = self._tensor([length] * 3 + [1.0] * 3)[:, None]
        self.base = self._tensor([scenario.tuner.weights for scenario in scenarios])
        self._disturbance: Any = self._tensor([getattr(s.estimator, "disturbance", 1.0) for s in scenarios])
        sensors = [s.sensors if isinstance(s.sensors, EncoderOptions) else None for s in scenarios]
        self._encoders = sensors[0] is not None
        self._offset = self._tensor([np.zeros(6) if each is None else each.read_offset for each in sensors]).T
        self._quantum = self._tensor([0.0 if each is None else each.quantum for each in sensors])
        bounds = [(scenario.bounds.rotation, scenario.bounds.position) for scenario in scenarios]
        self._bounds = self._tensor([[math.inf if b is None else b**2 for b in pair] for pair in bounds]).T
        self._first = self._start(sites)

    def start(self) -> LoopState:
        """Before the first tick."""
        return self._first

    def advance(
        self, state: LoopState, ticks: int, setting: Tensor | None = None, tuner: Tuner | None = None
    ) -> tuple[LoopState, Costs]:
        """Some ticks on.

        Args:
            state: Of `start` or of another `advance`.
            ticks: How many.
            setting: (B, 4) or (4,) from the next tick on; None for that of the state.
            tuner: What changes it; None for nothing.
        """
        if setting is not None:
            state = state._replace(setting=setting.expand(len(self.scenarios), 4))
        parts = []
        for _ in range(ticks):
            state, costs = self._tick(state, self._tables.row(state.tick), tuner)
            parts.append(costs)
        return state, Costs(*(torch.stack(each, dim=-1) for each in zip(*parts, strict=True)))

    @property
    def ticks(self) -> int:
        """Of the longest run, the first and the last included."""
        return 1 + max(self._last_tick(scenario) for scenario in self.scenarios)

    def scored(self, costs: Costs, state: LoopState, kappa: Any = 0.0, scales: CostScales | None = None) -> Tensor:
        """J (B,) of whole runs as `logs.cost.run_cost` has it, with the torque's scale times 10^-kappa.

        Args:
            costs: Of all `ticks`.
            state: At the end.
            kappa: [-] one, or (B,): from quiet to stiff.
            scales: None for the defaults.
        """
        scales = CostScales() if scales is None else scales
        late = torch.stack([self._late(scenario, costs.rotation.shape[-1]) for scenario in self.scenarios])
        later = late & torch.nn.functional.pad(late, (1, 0))[:, :-1]
        rotation, position = (torch.sqrt(_mean(each, late)) for each in costs[:2])
        # Scaling the unit of the torque's change is scaling the change.
        change = torch.sqrt(_mean(costs.change, later)) * (1e-3 / self.period) * 10.0**kappa
        found = torch.clamp(cost(rotation, position, change, scales), max=FAILED)
        return torch.where(state.alive & state.followed, found, FAILED)

    def _tick(self, state: LoopState, row: Row, tuner: Tuner | None) -> tuple[LoopState, Costs]:
        before = state
        plant, legs = self._plant.arrived(state.plant)
        good = (legs.cranks.reach > 0.0).all(dim=0)
        chain = self._plant.chain(legs)
        observer, compensation = state.observer, None
        if self._observer is None or observer is None:
            pose, rate = plant.pose, _pose_rate(plant)
            believed = chain if self._shared else Chain.at(self._believed, pose)
        else:
            if state.tick > 0:
                disturbance = disturbance_of(self._disturbance, state.setting)
                reading = self._reading(plant, row)
                observer, known = self._observer.corrected(observer, reading, row.wanted, disturbance)
                good = good & known
            observer, pose, rate = self._observer.looked_ahead(observer, state.sent)
            believed = Chain.at(self._believed, pose)
        push = torch.linalg.solve_ex(believed.inertia, believed.rows.mT)[0].permute(1, 2, 0).contiguous()
        if observer is not None:
            mobility = product(believed.jacobian.transpose(0, 1), push)
            compensation = -solved(mobility.permute(2, 0, 1), observer.surplus)
        error = pose - row.ahead[:6]
        wanted, integral = self._regulated(state, row, pose, rate, error, push)
        torque = wanted + row.friction
        if compensation is not None:
            torque = torque + compensation
        good = good & (believed.legs.transmission.abs() >= self._options.min_transmission).all(dim=0)

        asked = (*state.asked, torque)
        command = self._arriving(asked)
        sent = _clipped(torque, self._limit) - row.friction
        if self._observer is not None and observer is not None:
            observer = self._observer.expecting(observer, sent)
        applied = _clipped(command, self._motor_limit)
        for step in range(self._steps):
            if step > 0:
                plant, legs = self._plant.arrived(plant)
                good = good & (legs.cranks.reach > 0.0).all(dim=0)
                chain = self._plant.chain(legs)
            wrench = None if row.wrench is None else row.wrench[step]
            ahead = self._plant.pushed(plant, chain, applied, wrench)
            good = good & (ahead.twist.abs() < _WILD).all(dim=0)
            plant = kept(good, ahead, plant)

        memory, setting = state.memory, state.setting
        if tuner is not None:
            innovation = torch.zeros_like(error) if observer is None else observer.innovation
            setting, memory = tuner(Observed(error.T, torque.T, innovation.T, row.ahead.T), memory)
        off = before.plant.pose - row.wanted[:6]
        squares = (off[:3] ** 2).sum(dim=0), (off[3:] ** 2).sum(dim=0)
        last = _clipped(torque, self._motor_limit)
        alive, followed = self._following(state, squares, good, torque)
        costs = self._costs(squares, last - state.last, state.tick)
        later = LoopState(
            state.tick + 1,
            plant,
            observer,
            integral,
            (*state.sent, sent)[len(state.sent) + 1 - self._aheads[0] :] if self._aheads[0] else (),
            asked[len(asked) - self._delays[0] :] if self._delays[0] else (),
            last,
            alive,
            followed,
            setting,
            memory,
        )
        return frozen(alive, later, before), kept(alive, costs, Costs(*(each.detach() * 0.0 for each in costs)))

    def _regulated(
        self, state: LoopState, row: Row, pose: Tensor, rate: Tensor, error: Tensor, push: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Torque (6, B) of `lqi.lqi_tick`, and the integral (6, B) for the next tick."""
        options, limit = self._options, self._limit
        turning = kinematics_core.euler_rates(pose.T, push[:3])
        acceleration = torch.cat([options.length * turning, push[3:]])
        regulator = Regulator.at(acceleration, weights_of(self.base, state.setting).T, self.period)
        states = torch.stack([error, rate - row.ahead[6:12], state.integral])
        force = regulator.applied(self._scale * states)
        wanted = row.feedforward - (acceleration * force[:, None]).sum(dim=0)
        torque, grown = wanted, state.integral + self.period * error
        if options.saturation != "none":
            torque = _clipped(wanted, limit)
            cut = wanted - torque
            if bool((cut != 0.0).any()):
                if options.saturation == "back_calculation":
                    force = (acceleration * cut).sum(dim=1)
                    share = min(1.0, self.period / options.reset_time)
                    grown = grown + share * regulator.integral_for(force) / self._scale
                else:
                    grown = torch.where((cut != 0.0).any(dim=0), state.integral, grown)
        if options.integral_limit is not None:
            bound = self._tensor(np.repeat(options.integral_limit, 3))[:, None]
            grown = _clipped(grown, bound)
        return torque, grown

    def _reading(self, plant: PlantState, row: Row) -> Tensor:
        """What the encoders say of the cranks; a gradient passes their counts as if there were none."""
        if not self._encoders:
            cranks = kinematics_core.cranks_at(self._believed, plant.pose.T)
            return torch.atan2(cranks.sine, cranks.cosine)
        angles = plant.angles + self._offset
        if row.noise is not None:
            angles = angles + row.noise
        counting = self._quantum > 0.0
        quantum = torch.where(counting, self._quantum, 1.0)
        counts = torch.where(counting, torch.round(angles / quantum) * quantum, angles)
        return angles + (counts - angles).detach() if angles.requires_grad else counts

    def _arriving(self, asked: tuple[Tensor, ...]) -> Tensor:
        """What of the torques asked for so far, the last of them now, acts at the motors."""
        if len(asked) == 1:
            return asked[0]
        index = len(asked) - 1 - self._delay
        return torch.stack(asked).gather(0, index.expand(1, 6, -1))[0]

    def _following(
        self, state: LoopState, squares: tuple[Tensor, Tensor], good: Tensor, torque: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Which loops go on, and which of them have come within their bounds."""
        inside = (squares[0] <= self._bounds[0]) & (squares[1] <= self._bounds[1])
        followed = state.followed | (inside & state.alive)
        return state.alive & good & torch.isfinite(torque).all(dim=0) & (inside | ~followed), followed

    def _costs(self, squares: tuple[Tensor, Tensor], change: Tensor, tick: int) -> Costs:
        changed = (change * change).mean(dim=0)
        return Costs((180.0 / math.pi) ** 2 * squares[0], 1e6 * squares[1], changed if tick > 0 else 0.0 * changed)

    def _start(self, sites: Sequence[LoopSite]) -> LoopState:
        scenarios, count = self.scenarios, len(self.scenarios)
        states = [starting_state(s.robot, site.pose, site.pose_rate) for s, site in zip(scenarios, sites, strict=True)]
        chain = [self._tensor(np.stack(each, axis=-1)) for each in zip(*states, strict=True)]
        pose, pose_rate, twist, angles, anchor, slip = chain
        none = torch.zeros_like(pose)
        observer = None
        if self._observer is not None:
            seen = np.stack([self._first_pose(*each) for each in zip(scenarios, sites, states, strict=True)], axis=-1)
            believed = self._tensor(seen)
            observer = ObserverState(believed, pose_rate, none, none, none, believed, pose_rate)
        every = torch.ones(count, dtype=torch.bool, device=self._device)
        return LoopState(
            0,
            PlantState(pose, twist, angles, anchor, slip),
            observer,
            none,
            (self._still,) * self._aheads[0],
            (self._still,) * self._delays[0],
            none,
            every,
            ~every,
            self._tensor(np.zeros((count, 4))),
        )

    def _first_pose(self, scenario: Scenario, site: LoopSite, state: Any) -> np.ndarray:
        """Pose (6,) that an observer finds in its first tick, see `observing.observer_part`."""
        sensors = scenario.sensors
        if isinstance(sensors, EncoderOptions):
            angles = sensors.read(state.angles, 0)
        else:
            angles = inverse_kinematics(site.robot, site.pose)
        return estimate(site.robot, EncoderOptions(), self.period, angles, initial_memory(site.pose))[:6]

    def _last_tick(self, scenario: Scenario) -> int:
        return int(scenario.duration / scenario.plant.time_step * (1.0 + 1e-12)) // self._steps

    def _late(self, scenario: Scenario, count: int) -> Tensor:
        """(ticks,) of the second half."""
        tick = torch.arange(count, dtype=torch.float64, device=self._device)
        return (tick * self.period >= 0.5 * scenario.duration - 1e-9) & (tick <= self._last_tick(scenario))

    def _tensor(self, values: Any) -> Tensor:
        return torch.tensor(np.array(values), dtype=torch.float64, device=self._device)


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return torch.where(where, values, 0.0).sum(dim=-1) / where.sum(dim=-1)


def _clipped(values: Tensor, bound: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(values, -bound), bound)


def _pose_rate(plant: PlantState) -> Tensor:
    return torch.cat([kinematics_core.euler_rates(plant.pose.T, plant.twist[:3]), plant.twist[3:]])
