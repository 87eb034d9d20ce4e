"""A list of parts as C99: one record of signals and states, and the kernels called in order, as `LoopRunner` does."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from stewart_drake.base.errors import ConfigurationError, failure_code
from stewart_drake.base.sampling import steps_per
from stewart_drake.export.program import Program, braced, filled, from_template
from stewart_drake.export.source import ALLOWED, source_of
from stewart_drake.export.statements import wrapped
from stewart_drake.export.types import Array, Scalar, Struct, StructType, Untyped, number, struct_type
from stewart_drake.loop.part import HEALTHY, Part

_STATUSES = 32  # A kernel's statuses are below it.


class LoopSource:
    """The parts of a loop in C; arguments are those of `LoopRunner`.

    `given` are arrays at ports, by the names of members of the record that take their places; `variable` names
    parameters that are to be members too, as `part.parameter`.

    Attributes:
        program: The laws that have been printed.
        signals: All signals by name.
        places: Members of the record by name: the double with which it begins, and how many it has.
        numbers: Doubles in the record.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        outside: Mapping[str, int],
        inside: Mapping[str, Array],
        period: float,
        step: float,
        given: Mapping[str, np.ndarray],
        variable: Collection[str] = (),
    ) -> None:
        self.program, self.parts, self._given, self._variable = Program(), tuple(parts), given, variable
        self.numbers, self.places, self._members = 0, dict[str, tuple[int, int]](), list[str]()
        self._initial, self._runs = list[str](), list[str]()
        self._calls: dict[bool, list[str]] = {False: [], True: []}
        self.signals = {name: Array("double", f"loop->{name}", (size,)) for name, size in outside.items()}
        self.signals |= inside
        self._member("steps", "double steps", np.zeros(1))
        for name, size in {"failure": 2, **outside, **{name: x.size for name, x in given.items()}}.items():
            self._member(name, f"double {name}[{size}]", np.zeros(size))
        for part in parts:
            for name in part.outputs:
                kind, place = part.initial.dtype[name], f"loop->{part.name}.{name}"
                base = f"((double *)&{place})" if kind.names else place if kind.shape else f"(&{place})"
                self.signals[part.signal(name)] = Array("double", base, (part.size(name),))
        for k, part in enumerate(parts):
            self.add(k, part)
            steps = steps_per(f"{part.name}.period", part.period or period, step)
            due = "" if steps == 1 else f"fmod(loop->steps, {float(steps)}) == 0.0 && "
            call = f"    if ({due}(status = run_{part.name}(loop)) != 0) {{\n        return status;\n    }}"
            self._calls[part.end_of_tick].append(call)

    def _member(self, name: str, declaration: str, initial: np.ndarray) -> None:
        """A member of the record, with the numbers with which it begins."""
        self.places[name] = self.numbers, initial.view(np.float64).size
        self.numbers += self.places[name][1]
        self._members.append(f"    {declaration};")
        if np.any(initial.view(np.float64)):
            text = filled(initial) if initial.dtype.names else braced(initial)
            self._initial.append(f"    .{name} = {text},".replace("\n", "\n    "))

    def _record(self, name: str, of: StructType, initial: np.ndarray) -> Struct:
        """A member that is a record, as an argument."""
        self._member(name, f"struct {self.program.struct(of)} {name}", initial)
        return Struct(of, f"&loop->{name}")

    def add(self, k: int, part: Part) -> None:
        """The k-th part, as a function that is called `run_` and its name."""
        try:
            source = source_of(part.kernel)
        except Untyped as error:
            raise ConfigurationError(part.name, str(part.kernel), f"{ALLOWED}; this is {error}") from None
        try:
            lines = self._lines(k, part, [source.types.get(argument.arg) for argument in source.tree.args.args])
        except Untyped as error:
            raise source.refusal(source.tree.lineno, source.tree.name, str(error)) from None
        self._runs.append(f"static int run_{part.name}(struct loop *loop)\n{{\n" + "\n".join(lines) + "\n}")

    def _lines(self, k: int, part: Part, types: Sequence[Any]) -> list[str]:
        """The call of a part's kernel, with arguments of these types, and what follows from its status."""
        arguments = [self._leading(part, *leading) for leading in zip(part.leading.items(), types, strict=False)]
        of = struct_type(part.initial.dtype, types[-1])
        arguments += [self._input(part, name) for name in part.inputs]
        for n, kind in enumerate(part.scratch):
            name = f"{part.name}_scratch_{n}" if n else f"{part.name}_scratch"
            arguments.append(self._record(name, StructType(kind, kind.layout), kind.new()))
        arguments.append(self._record(part.name, of, part.initial))
        name, kinds, _ = self.program.function(part.kernel, arguments)
        call = f"{name}({', '.join(x.text if isinstance(x, Scalar) else x.pointer for x in arguments)})"
        if not kinds:
            return [wrapped(f"    {call};"), "    return 0;"]
        lines, target, undo, healthy = [], "loop->failure", [], []
        if part.fault_tolerant:
            target = f"loop->{part.name}.health"
            lines = [f"    const struct {self.program.struct(of)} before = loop->{part.name};"]
            healthy = [f"        {target}[{n}] = {value};" for n, value in enumerate(HEALTHY)]
            undo = ["    /* The safety layer gets the cause. */", f"    loop->{part.name} = before;"]
        lines.append(wrapped(f"    const {self.program.result(kinds)} result = {call};"))
        lines += ["    if (result.first == 0) {", *healthy, "        return 0;", "    }", *undo]
        causes, of_leg = np.ones(_STATUSES, dtype=int), np.zeros(_STATUSES, dtype=int)
        for status, ending in part.statuses.items():
            causes[status], of_leg[status] = failure_code(ending.reason), ending.of_leg
        lines.append(f"    {target}[0] = {self.program.table(f'{part.name}_causes', causes).base}[result.first];")
        leg = "-1"
        if kinds[1] == "int":
            leg = f"{self.program.table(f'{part.name}_of_leg', of_leg).base}[result.first] ? result.second : -1"
        return [*lines, f"    {target}[1] = {leg};", f"    return {0 if part.fault_tolerant else k + 1};"]

    def _leading(self, part: Part, item: tuple[str, Any], annotation: Any) -> Any:
        """A parameter or a constant as an argument."""
        (name, value), member = item, f"{part.name}_{item[0]}"
        if isinstance(value, (bool, int, float)):
            return number(value)
        if not isinstance(value, np.ndarray):
            raise Untyped(f"the constant `{name}`, an object that only Python has")
        is_variable = f"{part.name}.{name}" in self._variable
        if value.dtype.names:
            of = struct_type(value.dtype, annotation)
            if name in part.connections:
                pointer = self.signals[str(part.connections[name])].pointer
                return Struct(of, f"((const struct {self.program.struct(of)} *){pointer})", None)
            return self._record(member, of, value) if is_variable else self.program.constant_record(member, value, of)
        if name in part.connections:
            return self._input(part, name)
        if is_variable:
            self._member(member, f"double {member}[{value.size}]", value)
            return Array("double", f"loop->{member}", (value.size,))
        return self.program.table(member, value)

    def _input(self, part: Part, name: str) -> Array:
        source = "time" if name == "time" else part.source(name)
        if isinstance(source, str):
            return self.signals[source]
        for member, array in self._given.items():
            if array is source:
                return Array("double", f"loop->{member}", (array.size,))
        return self.program.table(f"no_{name}" if not np.any(source) else f"{part.name}_{name}", source)

    def text(self) -> str:
        """All but the functions that are called from outside."""
        signals = sorted(self.signals.items())
        words = {"LAWS": self.program.text(), "MEMBERS": "\n".join(self._members), "RUNS": "\n\n".join(self._runs)}
        words |= {"INITIAL": "\n".join(self._initial or ["    .steps = 0.0,"])}
        words |= {name: "\n".join(self._calls[end]) for name, end in (("PARTS", False), ("ENDS", True))}
        words["SIGNALS"] = "\n".join(f'    {{"{name}", {signal.shape[0]}}},' for name, signal in signals)
        words["POINTERS"] = "\n".join(f"    case {k}: return {x.pointer};" for k, (_, x) in enumerate(signals))
        return from_template("loop.c", words).replace("\n\n    return status", "\n    return status")
