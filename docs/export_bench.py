"""Sizes and instructions of exported controllers on a Cortex-M7, by a cross compiler and QEMU; writes docs/export.md's table.

Needs Debian's gcc-arm-none-eabi and qemu-system-arm. A minute: `python docs/export_bench.py`
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from stewart_drake.export.controller_c import c_name, export_controller
from stewart_drake.scenario.scenario import load_scenario

HERE = Path(__file__).parent
PAGE = HERE / "export.md"
BEGIN, END = "<!-- export_bench.py -->\n", "<!-- end -->\n"
SCENARIOS = ("reachy_nod", "reachy_look_around", "exact_breathing", "hold", "exact_fig7", "paper_fig7")
FLAGS = [
    "-std=gnu99",
    "-O2",
    "-mcpu=cortex-m7",
    "-mthumb",
    "-mfloat-abi=hard",
    "-mfpu=fpv5-d16",
    "-ffp-contract=off",
    "-ffunction-sections",
]
CLOCK = 480e6  # [Hz] of an STM32H7.


def measure(name: str) -> tuple[float, int, int, int, int]:
    """Period [s], text and data [byte] of the controller alone, mean and largest instructions of a step."""
    options = load_scenario(name)
    with tempfile.TemporaryDirectory() as place:
        folder, own = Path(place), c_name(name)
        export_controller(options, name, folder)
        rows = (folder / "replay.csv").read_text().split()
        sizes = dict(
            line.split()[1:3]
            for line in (folder / f"{own}.h").read_text().splitlines()
            if line.startswith("#define") and len(line.split()) > 2
        )
        reading, reference = (int(sizes[f"{own.upper()}_{each}"]) for each in ("READING", "REFERENCE"))
        table = ",\n".join(f"{{{row}}}" for row in rows)
        (folder / "rows.h").write_text(
            f"enum {{ ROWS = {len(rows)}, READING = {reading}, REFERENCE = {reference} }};\n"
            f"static const double rows[][{reading + reference + 7}] = {{\n{table}}};\n"
        )
        run = lambda *command: (
            subprocess.run(
                command, cwd=folder, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            ).stdout
        )
        run("arm-none-eabi-gcc", *FLAGS, "-Wall", "-Wextra", "-Werror", "-c", f"{own}.c")
        text, data, bss = map(int, run("arm-none-eabi-size", f"{own}.o").splitlines()[1].split()[:3])
        defined = f"-DNAME={own}", f"-DHEADER={own}.h", "-I."
        linked = "-nostartfiles", "-Wl,--gc-sections", "-T", str(HERE / "export_bench.ld")
        run(
            "arm-none-eabi-gcc",
            *FLAGS,
            *defined,
            *linked,
            "-o",
            "bench.elf",
            str(HERE / "export_bench.c"),
            f"{own}.o",
            "-lm",
            "-lc",
            "-lgcc",
        )
        printed = run(
            "qemu-system-arm",
            "-M",
            "mps2-an500",
            "-nographic",
            "-icount",
            "shift=0",
            "-semihosting",
            "-kernel",
            "bench.elf",
        )
        mean, most = map(int, printed.split())
        memory = 8 * int((folder / f"{own}.h").read_text().split("memory[")[1].split("]")[0])
        return options.reading_period, text, data + bss + memory, mean, most


def main() -> None:
    lines = [
        "| scenario | ticks a second | code and constants | memory | instructions a tick, mean | largest | at 480 MHz |\n",
        "|---|---|---|---|---|---|---|\n",
    ]
    for name in SCENARIOS:
        period, text, data, mean, most = measure(name)
        share = most / CLOCK
        lines.append(
            f"| `{name}` | {1 / period:g} | {text / 1024:.1f} KB | {data / 1024:.1f} KB | {mean:,} | {most:,} | {1e6 * share:.0f} us |\n"
        )
        print(lines[-1], end="")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + "".join(lines) + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
