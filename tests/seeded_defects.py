"""Seeded defects: small changes of the package, drawn with a seed, and which tests notice each of them.

    pip install "cosmic-ray>=8.3"        # in whatever environment runs this; --python names that of the tests
    python tests/seeded_defects.py [--python PYTHON] [--count 40] [--seed 19] [--only 3 --only 7] [-- PYTEST OPTIONS]

Each defect is put into a copy of the checkout, and the fast tests of its room run there: those in the folder of tests
that has the room's name, for a module outside of rooms those beside the folders. `--whole` runs all fast tests, those
of `make check`, a minute or two a defect. The table is tests/seeded_defects.jsonl, a row a defect, and
tests/seeded_defects.md; rows that are there already are kept. The first row has no defect: a test that fails there
catches nothing.
"""

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "seeded_defects.jsonl"
LEFT_OUT = ("NoOp", "Variable", "Bit", "Shift")
"""Parts of operators' names: those that need a name of ours, and those that no float takes."""
TESTS = ["-m", "not slow", "--hypothesis-profile=check", "--ignore=tests/benchmarks", "--ignore=tests/paper"]
ALWAYS = ["-q", "-n", "auto", "--hypothesis-seed=0", "--continue-on-collection-errors", "-o", "junit_family=xunit1"]
LIMIT = 1200.0
"""[s] for the tests of one defect; one that takes longer is caught."""


def possible(path):
    """Line and column -> operators that can change a file there, each with the number of its occurrence."""
    source = path.read_text()
    lines, notes, nodes = source.splitlines(), list(annotated(source)), list(ast_nodes(get_ast(source)))
    found = {}
    for name in sorted(name for name in operator_names() if not any(word in name for word in LEFT_OUT)):
        operator = get_operator(name)()
        spans = (span for node in nodes for span in operator.mutation_positions(node))
        for occurrence, (place, _) in enumerate(spans):
            if "TYPE_CHECKING" not in lines[place[0] - 1] and not any(a <= place < b for a, b in notes):
                found.setdefault(place, []).append((name, occurrence))
    return found


def annotated(source):
    """Line and column where each type annotation begins and ends."""
    for node in ast.walk(ast.parse(source)):
        note = getattr(node, "returns", None) or getattr(node, "annotation", None)
        if note is not None:
            yield (note.lineno, note.col_offset), (note.end_lineno, note.end_col_offset)


def draw(count, seed):
    """So many defects: a file, the longer the likelier, a place in it, and what to change there."""
    files = [path for path in sorted((ROOT / "stewart_drake").rglob("*.py")) if path.name != "__init__.py"]
    files = [path for path in files if "paper" not in path.parts]
    lengths = [len(path.read_text().splitlines()) for path in files]
    generator, places = random.Random(seed), {}
    for number in range(1, count + 1):
        (path,) = generator.choices(files, lengths)
        if path not in places:
            places[path] = possible(path)
        place = generator.choice(sorted(places[path]))
        name, occurrence = generator.choice(places[path].pop(place))
        source = path.read_text()
        changed = mutate_code(source, get_operator(name)(), occurrence)
        before, after = differing(source.splitlines(), changed.splitlines())
        row = {"id": number, "file": str(path.relative_to(ROOT)), "line": place[0], "operator": name}
        yield {**row, "before": before, "after": after}, changed


def differing(one, other):
    """The lines that two texts do not share."""
    head = next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    tail = 0
    while tail < min(len(one), len(other)) - head and one[-1 - tail] == other[-1 - tail]:
        tail += 1
    return tuple(" ".join(" ".join(part[head : len(part) - tail]).split()) for part in (one, other))


def tested(copy, python, options):
    """Names of the tests that fail in a copy, by file; and whether they ran to the end."""
    results = copy.parent / "results.xml"
    results.unlink(missing_ok=True)
    call = [python, "-m", "pytest", *ALWAYS, f"--junitxml={results}", *options]
    # numba keeps machine code by the path and the sources' digest: this copy's for the next defect.
    own = {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy.parent / "numba")}
    own |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (copy.parent / "output.txt").open("w") as output:
        process = subprocess.Popen(
            call, cwd=copy, env={**os.environ, **own}, stdout=output, stderr=output, start_new_session=True
        )
        try:
            ended = process.wait(LIMIT) in (0, 1)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            ended = False
    failed = []
    for case in ElementTree.parse(results).iter("testcase") if results.exists() else ():
        if case.find("failure") is not None or case.find("error") is not None:
            # A file that cannot be imported has but a name with dots.
            where = case.get("file") or case.get("name", "").replace(".", "/") + ".py"
            failed.append([where, case.get("name")])
    return failed, ended


def left_behind(folder, names):
    """What is no part of a copy: `runs` at the top alone, the package has a folder of that name."""
    top = {"runs"} if Path(folder) == ROOT else set()
    return {name for name in names if name in {".git", ".venv", "__pycache__", *top} or name.endswith("_cache")}


def of_room(file):
    """The tests of the room that a file of the package is in."""
    room = ROOT / "tests" / Path(file).parts[1]
    if room.is_dir():
        return [str(room.relative_to(ROOT))]
    return [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").glob("test_*.py"))]


def measure(row, copy, python, options, already):
    """A row with which tests caught its defect."""
    start = time.monotonic()
    failed, ended = tested(copy, python, options)
    caught = [each for each in failed if each not in already]
    counts = Counter(name for name, _ in caught)
    return {
        **row,
        "caught": bool(caught) or not ended,
        "ended": ended,
        "files": dict(counts.most_common()),
        "tests": caught if row["id"] == 0 else [f"{name}::{test}" for name, test in caught[:5]],
        "seconds": round(time.monotonic() - start),
    }


def page(rows):
    """The table in Markdown."""
    rows = [row for row in rows if row["id"]]
    missed = sum(not row["caught"] for row in rows)
    lines = [
        "# Seeded defects",
        "",
        f"{len(rows)} defects drawn by `python tests/seeded_defects.py`; the fast tests of their rooms catch "
        f"{len(rows) - missed}.",
        "",
        "| | where | before | after | caught by |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        by = ", ".join(f"{name.removeprefix('tests/')} ({count})" for name, count in list(row["files"].items())[:5])
        by = by or ("did not end" if row["caught"] else "**nothing**")
        code = [f"`{row[key].replace('|', chr(92) + '|')[:100]}`" if row[key] else "" for key in ("before", "after")]
        lines.append(f"| {row['id']} | {row['file']}:{row['line']} | {code[0]} | {code[1]} | {by} |")
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", type=os.path.abspath, default=sys.executable, help="that runs the tests")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=19)
    parser.add_argument("--only", type=int, action="append", help="defects of these numbers")
    parser.add_argument("--list", action="store_true", help="say what would be changed, and run nothing")
    parser.add_argument("--whole", action="store_true", help="all fast tests for each, not those of its room alone")
    parser.add_argument("options", nargs="*", default=TESTS, help="of pytest, after --")
    given = parser.parse_args()
    defects = list(draw(given.count, given.seed))
    if given.list:
        for row, _ in defects:
            print(f"{row['id']:3} {row['file']}:{row['line']}\n    {row['before']}\n    {row['after']}")
        return
    rows = {row["id"]: row for row in map(json.loads, TABLE.read_text().splitlines())} if TABLE.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=left_behind)
        for row, changed in [({"id": 0}, None), *defects]:
            wanted = not row["id"] or not given.only or row["id"] in given.only
            if not wanted or all(rows.get(row["id"], {}).get(key) == row[key] for key in row):
                continue
            if changed is not None:
                (copy / row["file"]).write_text(changed)
            where = [] if given.whole or not row["id"] else of_room(row["file"])
            rows[row["id"]] = measure(
                row, copy, given.python, [*given.options, *where], rows.get(0, {}).get("tests", [])
            )
            if changed is not None:
                # With its own time: Python and numba know a file by that.
                shutil.copy2(ROOT / row["file"], copy / row["file"])
            TABLE.write_text("".join(f"{json.dumps(rows[number])}\n" for number in sorted(rows)))
            TABLE.with_suffix(".md").write_text(page([rows[number] for number in sorted(rows)]))
            print(json.dumps(rows[row["id"]]), flush=True)


if __name__ == "__main__":
    main()
