"""Sizes and instructions of exported controllers on a Cortex-M7, by a cross compiler and QEMU.

Needs Debian's gcc-arm-none-eabi and qemu-system-arm. Half a minute: `python docs/scripts/export_bench.py`
writes the table of docs/export.md.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from stewart_drake.export.controller_c import c_name, export_controller
from stewart_drake.scenario.scenario import load_scenario

HERE = Path(__file__).parent
PAGE = HERE.parent / "export.md"
BEGIN, END = "<!-- export_bench.py -->\n", "<!-- end -->\n"
SCENARIOS = ("reachy_nod", "reachy_look_around", "exact_breathing", "hold", "exact_fig7", "paper_fig7")
FLAGS = "-std=gnu99 -O3 -mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16 -ffp-contract=off -Wall -Wextra -Werror"
MACHINE = "qemu-system-arm -M mps2-an500 -nographic -icount shift=0 -semihosting -kernel bench.elf"
CLOCK = 480e6  # [Hz] of an STM32H7.


class Measured(NamedTuple):
    """Of a controller."""

    period: float  # [s]
    text: int  # [byte] code and constants.
    memory: int  # [byte]
    mean: int  # Instructions of a step.
    most: int


def measure(name: str) -> Measured:
    """A scenario's controller, exported, compiled and run along its reference."""
    options, own = load_scenario(name), c_name(name)
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
        run(f"arm-none-eabi-gcc {FLAGS} -c {own}.c")
        text, data, bss = map(int, run(f"arm-none-eabi-size {own}.o").splitlines()[1].split()[:3])
        bench = f"-DNAME={own} -DHEADER={own}.h -I. -nostartfiles -T {HERE}/export_bench.ld {HERE}/export_bench.c"
        run(f"arm-none-eabi-gcc {FLAGS} {bench} {own}.o -o bench.elf -lm -lc -lgcc")
        mean, most = map(int, run(MACHINE).split())
        memory = data + bss + 8 * int(re.findall(r"memory\[(\d+)\]", header)[0])
        return Measured(options.reading_period, text, memory, mean, most)


def main() -> None:
    """Writes the table."""
    header = "scenario", "steps a second", "code and constants", "memory", "instructions, mean", "largest", "at 480 MHz"
    rows = [header, ("---",) * len(header)]
    for name in SCENARIOS:
        each = measure(name)
        sizes = [f"{size / 1024:.1f} KB" for size in (each.text, each.memory)]
        counts = f"{each.mean:,}", f"{each.most:,}", f"{1e6 * each.most / CLOCK:.0f} us"
        rows.append((f"`{name}`", f"{1.0 / each.period:g}", *sizes, *counts))
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + table + END + rest.partition(END)[2])
    print(table)


if __name__ == "__main__":
    main()
