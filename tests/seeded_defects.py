"""Seeded defects: small changes of the package, drawn with a seed, and which tests notice each of them.

    python tests/seeded_defects.py [--count 40] [--seed 19] [-- PYTEST OPTIONS]

Each defect is put into a copy of the checkout, and the tests of its room run there: those in the folder of tests that
has the room's name, and where they catch nothing its slow ones, and those beside the folders. The table is
tests/seeded_defects.jsonl, a row a defect, and tests/seeded_defects.md; rows that are there already are kept. The first
row has no defect: a test that fails there catches nothing.
"""

import argparse
import ast
import copy
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "seeded_defects.jsonl"
TESTS = [
    "--hypothesis-profile=check",
    "--ignore=tests/benchmarks",
    "--ignore=tests/paper",
    "-m",
    "not slow and not long",
]
ALWAYS = ["-q", "-n", "auto", "--hypothesis-seed=0", "--continue-on-collection-errors", "--tb=no", "-rfE"]
LIMIT = 1200.0
BINARY = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod, ast.Pow)
ORDERED = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
OPPOSITE = {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
NOTHING = ast.List(elts=[], ctx=ast.Load())


def variants(node):
    match node:
        case ast.BinOp(op=op) if isinstance(op, BINARY):
            return [changed(node, op=other()) for other in BINARY if not isinstance(op, other)]
        case ast.Compare(ops=[op]) if isinstance(op, ORDERED):
            return [changed(node, ops=[other()]) for other in ORDERED if not isinstance(op, other)]
        case ast.Compare(ops=[op]):
            return [changed(node, ops=[OPPOSITE[type(op)]()])]
        case ast.BoolOp(op=ast.And()):
            return [changed(node, op=ast.Or())]
        case ast.BoolOp():
            return [changed(node, op=ast.And())]
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            return [operand]
        case ast.Constant(value=bool()):
            return [ast.Constant(not node.value)]
        case ast.Constant(value=int() | float()):
            return [ast.Constant(node.value + 1), ast.Constant(node.value - 1)]
    return []


def changed(node, **parts):
    other = copy.copy(node)
    vars(other).update(parts)
    return other


def places(tree):
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in ast.unparse(tree.test):
        return
    for field, value in ast.iter_fields(tree):
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or field in ("annotation", "returns", "format_spec"):
                continue
            if isinstance(node, ast.JoinedStr):
                continue  # its parts have no places of their own before Python 3.12
            options = variants(node)
            if field == "test":
                options.append(ast.UnaryOp(ast.Not(), node))
            if field == "iter":
                options.append(NOTHING)
            if field == "decorator_list":
                options.append(None)
            if options:
                yield node, options
            yield from places(node)


def draw(count, seed):
    files = [path for path in sorted((ROOT / "stewart_drake").rglob("*.py")) if path.name != "__init__.py"]
    files = [path for path in files if "paper" not in path.parts]
    sources = [path.read_bytes() for path in files]
    generator, drawn = random.Random(seed), set()
    while len(drawn) < count:
        ((path, source),) = generator.choices(list(zip(files, sources, strict=True)), list(map(len, sources)))
        found = list(places(ast.parse(source)))
        node, options = generator.choice(found) if found else (None, [])
        if node is None or (path, node.lineno, node.col_offset) in drawn:
            continue
        drawn.add((path, node.lineno, node.col_offset))
        after = generator.choice(options)
        row = {"id": len(drawn), "file": str(path.relative_to(ROOT)), "line": node.lineno}
        text = "" if after is None else f"({ast.unparse(after)})"
        yield {**row, "before": ast.unparse(node), "after": text}, replaced(source, node, text)


def replaced(source, node, text):
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    begin, end = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
    return source[: begin - (not text)] + text.encode() + source[end:]


def tested(checkout, options):
    output = checkout.parent / "output.txt"
    call = [sys.executable, "-m", "pytest", *ALWAYS, *options]
    # numba keeps machine code by the path and the sources' digest: this copy's for the next defect.
    own = {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(checkout.parent / "numba")}
    own |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with output.open("w") as stream:
        pipes = {"stdout": stream, "stderr": stream, "start_new_session": True}
        process = subprocess.Popen(call, cwd=checkout, env={**os.environ, **own}, **pipes)
        try:
            ended = process.wait(LIMIT) in (0, 1)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            ended = False
    return re.findall(r"^(?:FAILED|ERROR) (\S+)", output.read_text(), re.MULTILINE), ended


def left_behind(folder, names):
    top = {"runs"} if Path(folder) == ROOT else set()
    left = {".git", "__pycache__", *top}
    return {name for name in names if name in left or name.startswith(".venv") or name.endswith("_cache")}


def selections(file):
    """Of pytest, one after the other until a defect is caught."""
    room = Path("tests", Path(file).parts[1])
    if (ROOT / room).is_dir():
        yield [str(room)]
        yield ["-m", "slow and not long", str(room)]
    yield [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").glob("test_*.py"))]


def measure(row, checkout, options, already):
    start = time.monotonic()
    failed, ended = tested(checkout, options)
    caught = [name for name in failed if name not in already]
    files = dict(Counter(name.partition("::")[0] for name in caught).most_common())
    kept = caught if row["id"] == 0 else caught[:5]
    seconds = round(time.monotonic() - start)
    return {**row, "caught": bool(caught) or not ended, "files": files, "tests": kept, "seconds": seconds}


def page(rows):
    rows = [row for row in rows if row["id"]]
    lines = [
        "# Seeded defects",
        "",
        f"{len(rows)} defects drawn by `python tests/seeded_defects.py`; the tests of their rooms catch "
        f"{sum(row['caught'] for row in rows)}.",
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
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=19)
    parser.add_argument("options", nargs="*", default=TESTS, help="of pytest, after --")
    given = parser.parse_args()
    defects = list(draw(given.count, given.seed))
    rows = {row["id"]: row for row in map(json.loads, TABLE.read_text().splitlines())} if TABLE.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "copy"
        shutil.copytree(ROOT, checkout, ignore=left_behind)
        for row, source in [({"id": 0}, None), *defects]:
            if all(rows.get(row["id"], {}).get(key) == row[key] for key in row):
                continue
            if source is not None:
                (checkout / row["file"]).write_bytes(source)
            already = rows.get(0, {}).get("tests", [])
            for selection in selections(row["file"]) if row["id"] else [[]]:
                rows[row["id"]] = measure(row, checkout, [*given.options, *selection], already)
                if rows[row["id"]]["caught"]:
                    break
            if source is not None:
                # With its own time: Python and numba know a file by that.
                shutil.copy2(ROOT / row["file"], checkout / row["file"])
            TABLE.write_text("".join(f"{json.dumps(rows[number])}\n" for number in sorted(rows)))
            TABLE.with_suffix(".md").write_text(page([rows[number] for number in sorted(rows)]))
            print(json.dumps(rows[row["id"]]), flush=True)


if __name__ == "__main__":
    main()
