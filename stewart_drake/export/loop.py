"""A list of parts as C99: one record of signals and states, and the kernels called in order, as `LoopRunner` does."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.errors import failure_code
from stewart_drake.base.sampling import steps_per
from stewart_drake.export.printer import Program, braced, filled
from stewart_drake.export.source import refusal, source_of
from stewart_drake.export.values import Array, Axis, Record, Scalar, Unknown, number
from stewart_drake.loop.part import HEALTHY, Part

_STATUSES = 32  # A kernel's statuses are below it.


class Signal(NamedTuple):
    """Where a signal stands in the record of a loop: its array, from where on, and how many numbers it has."""

    base: str
    start: int
    size: int

    @property
    def array(self) -> Array:
        """As an argument of a kernel."""
        return Array("double", self.base, (), (Axis(str(self.start), self.size),))

    @property
    def text(self) -> str:
        """A pointer to it."""
        return self.array.pointer(False)


class LoopSource:
    """The parts of a loop in C; arguments are those of `LoopRunner`.

    `given` are arrays that stand at ports, by the names of members of the record that take their places; `variable`
    names parameters that are to be members too, as `part.parameter`.

    Attributes:
        program: The laws that have been printed.
        signals: All signals by name.
        places: Members of the record by name: the double with which each begins, and how many it has.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        outside: Mapping[str, int],
        inside: Mapping[str, Signal],
        period: float,
        step: float,
        given: Mapping[str, np.ndarray],
        variable: Collection[str] = (),
    ) -> None:
        self.program, self.parts, self._given, self._variable = Program(), tuple(parts), given, variable
        self._members, self.places = ["double steps;", "double failure[2];"], {"steps": (0, 1), "failure": (1, 2)}
        self._initial: list[str] = []
        for name, size in {**outside, **{name: array.size for name, array in given.items()}}.items():
            self._member(name, f"double {name}[{size}]", size)
        self.signals = {name: Signal(f"loop->{name}", 0, size) for name, size in outside.items()}
        self.signals |= inside
        self._runs: list[str] = []
        self._calls: dict[bool, list[str]] = {False: [], True: []}
        for part in parts:
            self._state(part)
            for name in part.outputs:
                kind, place = part.initial.dtype[name], f"loop->{part.name}.{name}"
                base = place if kind.shape else f"((double *)&{place})" if kind.names else f"(&{place})"
                self.signals[part.signal(name)] = Signal(base, 0, part.size(name))
        for k, part in enumerate(parts):
            self._add(k, part)
            steps = steps_per(f"{part.name}.period", part.period or period, step)
            call = f"    status = run_{part.name}(loop);\n    if (status != 0) {{\n        return status;\n    }}\n"
            if steps > 1:
                inner = "".join(f"    {line}\n" for line in call.splitlines())
                call = f"    if (fmod(loop->steps, {float(steps)}) == 0.0) {{\n{inner}    }}\n"
            self._calls[part.end_of_tick].append(call)

    def _member(self, name: str, declaration: str, size: int | np.ndarray, initial: str = "") -> None:
        """A member of the record: so many doubles, or those of an array, with which it begins."""
        numbers = np.zeros(size) if isinstance(size, int) else _numbers(size)
        self._members.append(f"{declaration};")
        self.places[name] = self.numbers, numbers.size
        if np.any(numbers):
            self._initial.append(f"    .{name} = {_nested(initial)},")

    def _state(self, part: Part) -> None:
        kind = self.program.record(part.initial.dtype, f"{part.name}_state", part.kernel)
        self._member(part.name, f"struct {kind} {part.name}", part.initial, filled(part.initial))

    def add_apart(self, part: Part) -> None:
        """A part that is called by its own name alone, `run_` before it."""
        self._state(part)
        self._add(len(self.parts), part)

    def place(self, signal: str) -> tuple[int, int]:
        """The double of the record with which a signal begins, and how many it has."""
        for part in self.parts:
            for name in part.outputs:
                if part.signal(name) == signal:
                    return self.places[part.name][0] + part.initial.dtype.fields[name][1] // 8, part.size(name)  # type: ignore[index]
        return self.places[signal]

    # --- one part ---

    def _add(self, k: int, part: Part) -> None:
        arguments: list[Any] = []
        for name, value in part.leading.items():
            arguments.append(self._leading(part, name, value))
        for name, size in part.inputs.items():
            arguments.append(self._input(part, name, size))
        for n, record in enumerate(part.scratch):
            scratch: Any = getattr(record, "layout", record)
            member = f"{part.name}_scratch_{n}" if n else f"{part.name}_scratch"
            kind = self.program.record(scratch, member, part.kernel)
            self._member(member, f"struct {kind} {member}", scratch.itemsize // 8)
            arguments.append(Record(scratch, f"&loop->{member}"))
        arguments.append(Record(part.initial.dtype, f"&loop->{part.name}"))
        try:
            signature = self.program.function(part.kernel, arguments)
        except Unknown as error:
            source = source_of(part.kernel)
            raise refusal(f"{source.file}:{source.tree.lineno}", source.tree.name, str(error)) from None
        texts = [
            each.text if isinstance(each, Scalar) else each.pointer if isinstance(each, Record)
            else each.pointer(n not in signature.written)
            for n, each in enumerate(arguments)
        ]  # fmt: skip
        call, lines = f"{signature.name}({', '.join(texts)})", []
        if signature.result is None:
            lines += [f"    {call};", "    return 0;"]
        else:
            kinds = signature.result
            kind = self.program.record(part.initial.dtype, "", part.kernel)
            lines += [f"    const struct {kind} before = loop->{part.name};"] if part.fault_tolerant else []
            lines += [f"    const {self.program.result(kinds)} result = {call};"]
            leg = "result.second" if kinds[1:2] == ("int",) else "-1"
            causes, of_leg = self._causes(part)
            if part.fault_tolerant:
                lines += [
                    f"    double *health = loop->{part.name}.health;",
                    "    if (result.first == 0) {",
                    f"        health[0] = {HEALTHY[0]};",
                    f"        health[1] = {HEALTHY[1]};",
                    "        return 0;",
                    "    }",
                    "    /* The state is as it was; the safety layer hears of it. */",
                    f"    loop->{part.name} = before;",
                    f"    health[0] = {causes.at(['result.first']).text};",
                    f"    health[1] = {of_leg.at(['result.first']).text} ? {leg} : -1;",
                    "    return 0;",
                ]
            else:
                lines += [
                    "    if (result.first == 0) {",
                    "        return 0;",
                    "    }",
                    f"    loop->failure[0] = {causes.at(['result.first']).text};",
                    f"    loop->failure[1] = {of_leg.at(['result.first']).text} ? {leg} : -1;",
                    f"    return {k + 1};",
                ]
        self._runs.append(f"static int run_{part.name}(struct loop *loop)\n{{\n" + "\n".join(lines) + "\n}")

    def _leading(self, part: Part, name: str, value: Any) -> Any:
        if name in part.connections:
            signal = self.signals[str(part.connections[name])]
            kind = self.program.record(value.dtype, f"{part.name}_{name}", part.kernel)
            return Record(value.dtype, f"((const struct {kind} *){signal.text})", None)
        if f"{part.name}.{name}" in self._variable:
            member = f"{part.name}_{name}"
            if not value.dtype.names:
                self._member(member, f"double {member}[{value.size}]", value, braced(value))
                return Signal(f"loop->{member}", 0, value.size).array
            kind = self.program.record(value.dtype, member, part.kernel)
            self._member(member, f"struct {kind} {member}", value, filled(value))
            return Record(value.dtype, f"&loop->{member}")
        if isinstance(value, np.ndarray) and value.dtype.names:
            return self.program.constants_of(f"{part.name}_{name}", value, part.kernel)
        if isinstance(value, np.ndarray):
            return self.program.table(f"{part.name}_{name}", value)
        if isinstance(value, (bool, int, float)):
            return number(value)
        return value  # The printer refuses it, with its kernel's line.

    def _input(self, part: Part, name: str, size: int) -> Array:
        source = "time" if name == "time" else part.source(name)
        if isinstance(source, str):
            return self.signals[source].array
        for member, array in self._given.items():
            if array is source:
                return Signal(f"loop->{member}", 0, size).array
        return self.program.table(f"no_{name}" if not np.any(source) else f"{part.name}_{name}", source)

    def _causes(self, part: Part) -> tuple[Array, Array]:
        """What of `errors.FAILURES` a status means, and whether it is that of a leg."""
        causes, of_leg = np.ones(_STATUSES, dtype=int), np.zeros(_STATUSES, dtype=int)
        for status, ending in part.statuses.items():
            causes[status], of_leg[status] = failure_code(ending.reason), ending.of_leg
        return self.program.table(f"{part.name}_causes", causes), self.program.table(f"{part.name}_of_leg", of_leg)

    # --- text ---

    def text(self) -> str:
        """All but the functions that are called from outside."""
        members = "".join(f"    {member}\n" for member in self._members)
        return "\n".join(
            [
                self.program.text("\n".join(self._runs)),
                "/* All signals and states. */",
                f"struct loop {{\n{members}}};\n",
                "static const struct loop initial = {\n" + "\n".join(self._initial or ["    .steps = 0.0,"]) + "\n};\n",
                "\n\n".join(self._runs) + "\n",
                self._chain("run_parts", "The parts that are due, but those of the end of a tick.", False),
                self._chain("end_parts", "What acts from the next tick on.", True),
                self._signal_table(),
            ]
        )

    def _chain(self, name: str, said: str, end: bool) -> str:
        calls = self._calls[end]
        body = "    int status;\n" + "".join(calls) if calls else "    (void)loop;\n"
        said = f"/* {said} Returns 0, or which part failed, counted from 1. */"
        return f"{said}\nstatic int {name}(struct loop *loop)\n{{\n{body}    return 0;\n}}\n"

    def _signal_table(self) -> str:
        names = sorted(self.signals)
        rows = "".join(f'    {{"{name}", {self.signals[name].size}}},\n' for name in names)
        cases = "".join(f"    case {k}: return {self.signals[name].text};\n" for k, name in enumerate(names))
        return (
            f"static const struct {{\n    const char *name;\n    int size;\n}} signals[] = {{\n{rows}}};\n\n"
            "static const double *signal_at(const struct loop *loop, int k)\n{\n    switch (k) {\n"
            f"{cases}    default: return 0;\n    }}\n}}\n"
        )

    @property
    def numbers(self) -> int:
        """Doubles in the record."""
        start, size = list(self.places.values())[-1]
        return start + size


def _numbers(record: np.ndarray) -> np.ndarray:
    return record.view(np.float64)


def _nested(text: str) -> str:
    return text.replace("\n", "\n    ")


def table_of(rows: np.ndarray) -> str:
    """Rows of numbers (n, k) as C initialises an array with them."""
    return ",\n".join("    {" + ", ".join(number(value).text for value in row) + "}" for row in rows)
