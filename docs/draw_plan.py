"""Draws docs/images/plan.png, the rooms of the package, from the code and the contract in pyproject.toml: `make plan`.

A row is a layer of the contract; a room imports only from rows below its own. An arrow is an import that no chain of
other arrows implies.
"""

import ast
import textwrap
import tomllib
from pathlib import Path

import grimp
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).parents[1]
PACKAGE = "stewart_drake"
WIDTH, HEIGHT, GAP = 2.6, 0.62, 0.5


def room_of(module: str) -> str:
    """The room, or the module of the root, to which a module belongs."""
    return ".".join(module.split(".")[:2])


def layers() -> list[list[str]]:
    """Rooms from the top layer of the contract to the lowest."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [[room.strip() for room in row.split("|")] for row in rows]


def arrows(rooms: list[str]) -> set[tuple[str, str]]:
    """Imports between rooms, without those that a chain of others implies."""
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True)
    direct: dict[str, set[str]] = {room: set() for room in rooms}
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            above, below = room_of(module), room_of(other)
            if above != below and above in direct and below in direct:
                direct[above].add(below)

    def reach(room: str) -> set[str]:
        return set().union(*({below} | reach(below) for below in direct[room])) if direct[room] else set()

    return {
        (above, below)
        for above, belows in direct.items()
        for below in belows
        if not any(below in reach(other) for other in belows - {below})
    }


def text_of(room: str) -> tuple[str, str]:
    """Name and size of a room, and the first line of its docstring."""
    place = ROOT.joinpath(*room.split("."))
    files = [place.with_suffix(".py")] if place.with_suffix(".py").is_file() else sorted(place.rglob("*.py"))
    doc = ast.get_docstring(ast.parse(files[0].read_text())) or ""
    lines = sum(len(file.read_text().splitlines()) for file in files)
    return f"{room.split('.')[1]}  ({lines:,} lines)", textwrap.fill(doc.splitlines()[0], 44)


def main() -> None:
    """Draws the picture."""
    rows = layers()
    widest = max(map(len, rows))
    places = {}
    figure, axes = plt.subplots(figsize=(13, 1.0 * len(rows)), layout="constrained")
    for level, row in enumerate(rows):
        for index, room in enumerate(row):
            x = (index + 0.5 - len(row) / 2) * (WIDTH + GAP)
            places[room] = (x, -level)
            name, doc = text_of(room)
            axes.add_patch(
                FancyBboxPatch(
                    (x - WIDTH / 2, -level - HEIGHT / 2), WIDTH, HEIGHT, "round,pad=0.02", fc="#eef3f8", ec="#446"
                )
            )
            axes.text(x, -level + 0.14, name, ha="center", va="center", fontsize=9, weight="bold")
            axes.text(x, -level - 0.12, doc, ha="center", va="center", fontsize=6.3)
    for above, below in sorted(arrows(list(places))):
        (x0, y0), (x1, y1) = places[above], places[below]
        start, end = (x0, y0 - HEIGHT / 2), (x1, y1 + HEIGHT / 2)
        bend = 0.0 if y0 - y1 < 1.5 else 0.15
        axes.add_patch(
            FancyArrowPatch(
                start,
                end,
                arrowstyle="-|>",
                mutation_scale=9,
                color="#789",
                lw=0.8,
                connectionstyle=f"arc3,rad={bend}",
                zorder=0,
            )
        )
    reach = widest * (WIDTH + GAP) / 2
    axes.set(xlim=(-reach, reach), ylim=(-len(rows) + 0.4, 0.6))
    axes.axis("off")
    figure.savefig(ROOT / "docs" / "images" / "plan.png", dpi=130)


if __name__ == "__main__":
    main()
