"""Who imports whom, and that what the texts in the code name is there."""

import graphlib
import importlib.util
import json
import re
from pathlib import Path

import grimp
from PIL import Image

from stewart_drake.scenario import Scenario

ROOT = Path(__file__).parents[1]


def test_no_circle_of_files():
    graph = grimp.build_graph("stewart_drake", exclude_type_checking_imports=True)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    graphlib.TopologicalSorter(imports).prepare()  # raises CycleError, which names the circle


def test_picture_of_the_rooms_is_current():
    spec = importlib.util.spec_from_file_location("draw_plan", ROOT / "docs" / "draw_plan.py")
    draw_plan = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw_plan)
    with Image.open(ROOT / "docs" / "images" / "plan.png") as picture:
        shown = json.loads(picture.text["Description"])
    assert shown == draw_plan.plan(), "run `make plan`"


PACKAGE = ROOT / "stewart_drake"
FILES = sorted(PACKAGE.rglob("*.py"))
TEXTS = {str(path.relative_to(PACKAGE)): path.read_text() for path in FILES}
ENDINGS = {"json", "jsonl", "md", "parquet", "py", "sdf", "xml", "yaml"}
OWN = {"mujoco", "options", "part", "stewart", "stewart_drake", "task"}


def source_of(name):
    rooms = [path.parent for path in FILES if path.name == "__init__.py" and path.parent.name == name]
    files = [path for path in FILES if path.stem == name] + [room / "__init__.py" for room in rooms]
    return "\n".join(path.read_text() for path in files), [path.stem for room in rooms for path in room.glob("*.py")]


def test_what_a_text_refers_to_by_its_module_is_there():
    dead = []
    for file, text in TEXTS.items():
        for name, part in re.findall(r"(?<!`)`([a-z_]+)\.([A-Za-z_]+)`(?!`)", text):
            if part in ENDINGS or name in OWN or name in Scenario.__pydantic_fields__:
                continue
            source, inside = source_of(name)
            known = re.search(rf"\b{part}\b", source) or part in inside
            if not known and (source or importlib.util.find_spec(name) is None):
                dead.append(f"{file}: {name}.{part}")
    assert dead == []
