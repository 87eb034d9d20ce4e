"""Who imports whom."""

import graphlib
import importlib.util
import json
from pathlib import Path

import grimp
from PIL import Image

ROOT = Path(__file__).parents[1]


def test_no_circle_of_files():
    graph = grimp.build_graph("stewart_drake", exclude_type_checking_imports=True)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    order = list(graphlib.TopologicalSorter(imports).static_order())  # raises CycleError, which names the circle
    assert order.index("stewart_drake.base.errors") < order.index("stewart_drake.cli.app")


def test_picture_of_the_rooms_is_current():
    spec = importlib.util.spec_from_file_location("draw_plan", ROOT / "docs" / "scripts" / "draw_plan.py")
    draw_plan = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw_plan)
    with Image.open(ROOT / "docs" / "images" / "plan.png") as picture:
        shown = json.loads(picture.text["Description"])
    assert shown == draw_plan.plan(), "run `python docs/scripts/draw_plan.py`"
