"""Sizes and instructions of exported controllers on a Cortex-M7 and a Cortex-M0+, by a cross compiler and QEMU.

Needs Debian's gcc-arm-none-eabi and qemu-system-arm. Half a minute: `python docs/scripts/export_bench.py`
writes the tables of docs/export.md.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from stewart_drake.export.controller_c import c_name, export_controller
from stewart_drake.scenario.scenario import load_driven

HERE = Path(__file__).parent
PAGE = HERE.parent / "export.md"
BEGIN, END = "<!-- export_bench.py -->\n", "<!-- end -->\n"
SCENARIOS = ("reachy_nod", "reachy_look_around", "exact_breathing", "hold", "exact_fig7", "paper_fig7")
RC_SERVOS = "model.motors={kind: position, preset: mg996r, delay: 0.02}"


class Processor(NamedTuple):
    """A processor that QEMU emulates."""

    flags: str
    machine: str
    clock: float  # [Hz]


M7 = Processor("-O3 -mcpu=cortex-m7 -mfloat-abi=hard -mfpu=fpv5-d16", "mps2-an500", 480e6)  # an STM32H7
M0 = Processor("-O2 -mcpu=cortex-m0plus -mfloat-abi=soft", "mps2-an385", 133e6)  # an RP2040
FLAGS = "-std=gnu99 -mthumb -ffp-contract=off -Wall -Wextra -Werror"
MACHINE = "qemu-system-arm -nographic -icount shift=0 -semihosting -kernel bench.elf -M"


class Measured(NamedTuple):
    """Of a controller."""

    period: float  # [s]
    text: int  # [byte] code and constants.
    memory: int  # [byte]
    mean: int  # Instructions of a step.
    most: int


def measure(name: str, on: Processor = M7, overrides: tuple[str, ...] = ()) -> Measured:
    """A scenario's controller, exported, compiled and run along its reference."""
    options, own, flags = load_driven(name, overrides), c_name(name), f"{FLAGS} {on.flags}"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)

        def run(command: str) -> str:
            done = subprocess.run(command.split(), cwd=folder, capture_output=True, text=True)
            if done.returncode != 0:
                raise SystemExit(f"{command}\n{done.stderr}")
            return done.stdout + done.stderr

        export_controller(options, name, folder)
        header, rows = (
            (folder / f"{own}.h").read_text(encoding="utf-8"),
            (folder / "replay.csv").read_text("utf-8").split(),
        )
        reading, reference = (int(re.findall(rf"_{each} (\d+)", header)[0]) for each in ("READING", "REFERENCE"))
        table = ",\n".join(f"{{{row}}}" for row in rows)
        (folder / "rows.h").write_text(
            f"enum {{ ROWS = {len(rows)}, READING = {reading}, REFERENCE = {reference} }};\n"
            f"static const double rows[][{reading + reference + 7}] = {{\n{table}}};\n",
            encoding="utf-8",
        )
        run(f"arm-none-eabi-gcc {flags} -c {own}.c")
        text, data, bss = map(int, run(f"arm-none-eabi-size {own}.o").splitlines()[1].split()[:3])
        bench = f"-DNAME={own} -DHEADER={own}.h -I. -nostartfiles -T {HERE}/export_bench.ld {HERE}/export_bench.c"
        run(f"arm-none-eabi-gcc {flags} {bench} {own}.o -o bench.elf -lm -lc -lgcc")
        mean, most = map(int, run(f"{MACHINE} {on.machine}").split())
        memory = data + bss + 8 * int(re.findall(r"memory\[(\d+)\]", header)[0])
        return Measured(options.reading_period, text, memory, mean, most)


def table(rows: dict[str, Measured], clock: float) -> str:
    """Rows by their names, as Markdown."""
    header = "scenario", "steps a second", "code and constants", "memory", "instructions, mean", "largest"
    lines = [(*header, f"at {clock / 1e6:g} MHz"), ("---",) * 7]
    for name, each in rows.items():
        sizes = [f"{size / 1024:.1f} KB" for size in (each.text, each.memory)]
        counts = f"{each.mean:,}", f"{each.most:,}", f"{1e6 * each.most / clock:.0f} us"
        lines.append((name, f"{1.0 / each.period:g}", *sizes, *counts))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> None:
    """Writes the tables."""
    boards = {
        "`hobby_servos`": measure("hobby_servos", M0),
        "the same with RC servos": measure("hobby_servos", M0, (RC_SERVOS,)),
    }
    tables = table({f"`{name}`": measure(name) for name in SCENARIOS}, M7.clock), table(boards, M0.clock)
    before, first, between, second, rest = re.split(rf"(?s)({BEGIN}).*?{END}", PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(f"{before}{first}{tables[0]}{END}{between}{second}{tables[1]}{END}{rest}")
    print("\n".join(tables))


if __name__ == "__main__":
    main()
