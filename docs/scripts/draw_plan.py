"""Draws docs/images/plan.png, the rooms of the package, from the code and pyproject.toml: `make pictures`.

A row is a layer of the contract; a room imports only from rows below its own. An arrow is an import that no chain of
other arrows implies. What the picture shows is kept in its file as text, so that a test can see whether it is current.
"""

import ast
import json
import textwrap
import tomllib
from pathlib import Path

import grimp
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).parents[2]
PACKAGE = "stewart_drake"
WIDTH, HEIGHT, GAP = 2.6, 0.76, 0.5


def room_of(module: str) -> str:
    """The room, or the module of the root, to which a module belongs."""
    return ".".join(module.split(".")[:2])


def layers() -> list[list[str]]:
    """Rooms from the top layer of the contract to the lowest."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
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


def subject_of(room: str) -> str:
    """First line of a room's docstring."""
    place = ROOT.joinpath(*room.split("."))
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").splitlines()[0]


def plan() -> dict[str, list]:
    """What the picture shows: rows of [room, subject], and arrows."""
    rows = layers()
    return {
        "rows": [[[room, subject_of(room)] for room in row] for row in rows],
        "arrows": sorted(map(list, arrows([room for row in rows for room in row]))),
    }


def main() -> None:
    """Draws the picture."""
    shown = plan()
    rows = shown["rows"]
    widest = max(map(len, rows))
    places = {}
    figure, axes = plt.subplots(figsize=(13, 1.0 * len(rows)), layout="constrained")
    for level, row in enumerate(rows):
        for index, (room, subject) in enumerate(row):
            x = (index + 0.5 - len(row) / 2) * (WIDTH + GAP)
            places[room] = (x, -level)
            axes.add_patch(
                FancyBboxPatch(
                    (x - WIDTH / 2, -level - HEIGHT / 2), WIDTH, HEIGHT, "round,pad=0.02", fc="#eef3f8", ec="#446"
                )
            )
            axes.text(x, -level + 0.26, room.split(".")[1], ha="center", va="center", fontsize=9, weight="bold")
            axes.text(x, -level - 0.09, textwrap.fill(subject, 38), ha="center", va="center", fontsize=6.3)
    for above, below in shown["arrows"]:
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
    figure.savefig(ROOT / "docs" / "images" / "plan.png", dpi=130, metadata={"Description": json.dumps(shown)})


if __name__ == "__main__":
    main()
