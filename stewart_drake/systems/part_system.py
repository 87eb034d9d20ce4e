"""A part of the loop as a LeafSystem: the one shell around all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, InputPort, LeafSystem, OutputPort

from stewart_drake.errors import RunFailure
from stewart_drake.part import Part
from stewart_drake.sampling import on_grid

_AHEAD = 1.0 + 4e-10
"""A tick's instant begins a little early: decimal times, at which others may ask, come before the stretched ones."""


class PartSystem(LeafSystem):
    """Runs a part at its ticks; its state is in the Context.

    What a part says at a tick is computed from the inputs of that very instant, as soon as somebody asks for it, and
    the discrete update then stores it: a torque in discrete state alone would reach the plant one plant step late. A
    part that is `late` ticks in the update.

    The plant must step in a discrete update too, as `plant.add_plant` makes it: a `MultibodyPlant` with sampled outputs
    (Drake's default) steps before all discrete updates of its instant, and what is stored would see it one step late.

    Args:
        part: What it does.
        period: [s] tick period; ticks at 0, period, 2 period, ...

    Attributes:
        part: See above.
        period: [s] as Drake has it, see `sampling.on_grid`; the period for a log of every tick.
        result: Port: the part's state, and the number of ticks done. A port for each output costs a call of Python
            where it is asked for; a Demultiplexer on this one does not.

    Ports: those of the part, by name and as attributes; an output with the name of an input is the attribute
    `NAME_out`. An input whose part has an array for it may be left alone.
    """

    if TYPE_CHECKING:
        # Ports are attributes by name; a type checker cannot know which.
        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, part: Part, period: float) -> None:
        super().__init__()
        self.part, self.period = part, on_grid(period)
        self._tick, self._kind = part.tick, part.initial.dtype
        initial = np.append(part.initial.view(np.float64), 0.0)
        index = self.DeclareDiscreteState(initial)
        self._time = np.zeros(1)
        # What stands at a port: its value, and for one that may be left alone what stands there then.
        self._ports: list[tuple[InputPort | None, np.ndarray | None]] = []
        for name, size in part.inputs.items():
            if name == "time":
                self._ports.append((None, self._time))
                continue
            port, otherwise = self.DeclareVectorInputPort(name, size), part.source(name)
            self._ports.append((port, None if isinstance(otherwise, str) else otherwise))
            setattr(self, name, port)
        self.result: OutputPort
        if part.late:
            self.result = self.DeclareStateOutputPort("result", index)
        else:
            needs = {self.time_ticket(), self.xd_ticket(), self.all_input_ports_ticket()}
            self.result = self.DeclareVectorOutputPort(
                "result", len(initial), self._answer, prerequisites_of_calc=needs
            )
        for name in part.outputs:
            setattr(self, f"{name}_out" if name in part.inputs else name, self._slice(name))
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._store)

    def state(self, context: Context) -> np.ndarray:
        """The part's record (1,) as it is now; of the tick that has been asked for, though nothing has stored it.

        Args:
            context: Of the whole Diagram.
        """
        mine = self.GetMyContextFromRoot(context)
        if not self.part.late:
            entry = self.get_output_port(self.result.get_index()).cache_entry()
            if not entry.is_out_of_date(mine):
                return np.array(self.result.Eval(mine)[:-1]).view(self._kind)
        return np.array(mine.get_discrete_state(0).value()[:-1]).view(self._kind)

    def sizes(self) -> tuple[list[int], list[int | None]]:
        """How a Demultiplexer splits `result`: sizes in order, and at which of them each output of the part is."""
        starts = {int(self._kind.fields[name][1]) // 8: name for name in self.part.outputs}  # type: ignore[index]
        sizes, at, place = [], {}, 0
        for start in sorted(starts):
            if start > place:
                sizes.append(start - place)
            at[starts[start]] = len(sizes)
            sizes.append(self.part.size(starts[start]))
            place = start + sizes[-1]
        rest = self._kind.itemsize // 8 + 1 - place
        return [*sizes, rest], [at[name] for name in self.part.outputs]

    def _slice(self, name: str) -> OutputPort:
        start, size = int(self._kind.fields[name][1]) // 8, self.part.size(name)  # type: ignore[index]

        def calc(context: Context, output: Any) -> None:
            output.SetFromVector(self.result.Eval(context)[start : start + size])

        ticket = self.get_output_port(self.result.get_index()).cache_entry().ticket()
        needs = {self.xd_ticket()} if self.part.late else {ticket}
        return self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=needs)

    @staticmethod
    def _at(port: InputPort | None, otherwise: np.ndarray | None, context: Context) -> Any:
        if port is None or (otherwise is not None and not port.HasValue(context)):
            return otherwise
        return port.Eval(context)

    def _ticked(self, context: Context, values: np.ndarray, now: float) -> None:
        """Ticks on values (n + 1,) that hold the state of the tick before."""
        self._time[0] = context.get_time()
        try:
            self._tick(
                *(self._at(port, otherwise, context) for port, otherwise in self._ports), values[:-1].view(self._kind)
            )
        except RunFailure as error:
            error.time = context.get_time()
            raise
        values[-1] = int(now + 1e-6) + 1.0

    def _answer(self, context: Context, output: Any) -> None:
        values, held = output.get_mutable_value(), context.get_discrete_state(0).value()
        values[:] = held
        now = context.get_time() / self.period
        if now * _AHEAD + 1e-6 >= held[-1]:
            self._ticked(context, values, now)

    def _store(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self.part.late:
            values = discrete_state.get_mutable_value(0)
            self._ticked(context, values, context.get_time() / self.period)
        else:
            discrete_state.set_value(0, self.result.Eval(context))
