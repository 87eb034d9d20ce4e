"""Attacks files of every kind, each in a process with a limit on time and memory: `attacked_files.py FOLDER [SEED]`.

Prints a line of JSON for each kind: its name, the status of its process, and how many files were loaded and refused.
Status 0: each was loaded, or refused by one line; what did neither is shown and kept in the folder of its kind.
"""

import json
import os
import re
import resource
import signal
import socket
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from conftest import make_network, resealed
from made_logs import made_log

from stewart_drake.campaigns.comparison_file import load_comparison
from stewart_drake.campaigns.sweep_file import load_sweep
from stewart_drake.control.network import load_network
from stewart_drake.control.user_controller import PythonOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.files import parquet_files
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.files.whole import digest
from stewart_drake.files.yaml_files import shipped_folder
from stewart_drake.logs.log import load_log
from stewart_drake.references import RecordedReference
from stewart_drake.scenario import load_scenario
from stewart_drake.training.dataset import Dataset, load_dataset

MEMORY = 1_500_000_000
"""[byte] that loading may take beyond what the modules do."""
SECONDS = 30
"""Of work for one file; ten times as long where it waits."""
ROUNDS = int(os.environ.get("STEWART_DRAKE_ATTACKS", "60"))
"""Of attacks on each kind of file; more of them for a longer search."""

SWEEP = b"""scenario: exact_fig7
runs: 5
set: {duration: 1.0}
distributions:
  initial_offset[5]: {kind: normal, mean: 0.0, std: 0.001, low: -0.002}
  robot.rod_length: {kind: uniform, low: 0.9, high: 1.1, factor: true}
  gravity: {kind: choice, values: [3, 4.5]}
"""
COMPARISON = b"""scenario: exact_fig7
set: {duration: 0.5}
controllers: {LQI: {}, PID: {controller: {kind: pid}}}
references: {hold: {reference: {kind: hold}}, slow: {duration: 0.2}}
conditions: {nominal: {}, noisy: {gravity: 3.0, initial_offset: [0, 0, 0, 0, 0, 0.001]}}
seeds: [1, 2]
"""
CONTROLLER = b"""import numpy as np
from pydrake.systems.framework import LeafSystem


class Mine(LeafSystem):
    def __init__(self, scale=1.0):
        super().__init__()
        self.scale = [12.0 * scale, 1e-3]
        self.DeclareVectorInputPort("measurement", 12)
        self.DeclareVectorOutputPort("torque", 6, self.calc)

    def calc(self, context, output):
        output.SetFromVector(np.full(6, 0.33 * self.scale))
"""


@dataclass(frozen=True)
class Kind:
    """Files of one kind: their name, a good one, what loads them, what makes the checksum of a bad one fit again."""

    name: str
    make: Callable[[Path], bytes]
    load: Callable[[Path], object]
    reseal: Callable[[bytes], bytes] = bytes


def _scenario(_):
    own = b"\ntuner: {kind: paper, weights_file: own.json}\n"
    return (shipped_folder("scenarios") / "heart.yaml").read_bytes() + own


def _dataset(path):
    rng = np.random.default_rng(0)
    Dataset(rng.uniform(0.0, 3.0, (40, 12)), rng.uniform(1.0, 2.0, (40, 2)), np.arange(40) // 9, np.arange(40.0)).save(
        path
    )
    return path.read_bytes()


def _log(_):
    return made_log(rows=5).to_parquet()


def _csv(_):
    rows = [f"{0.1 * k:g},0,{0.01 * k:g},0,0,0,0.3" for k in range(30)]
    return "\n".join(["time,roll,pitch,yaw,x,y,z", *rows, ""]).encode()


def _parquet(path):
    import pyarrow as pa
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    pq.write_table(pc.read_csv(pa.BufferReader(_csv(path))), path)
    return path.read_bytes()


def _resealed_json(content):
    try:
        return resealed(dict(json.loads(content)))
    except (ValueError, TypeError, RecursionError):
        return content


def _resealed_parquet(content):
    import io

    stream = io.BytesIO(content)
    place = parquet_files._place_of_digits(stream)
    if place is not None:
        found = parquet_files._digest(stream, place)
        stream.seek(place)
        stream.write(found)
    return stream.getvalue()


def _recording(path):
    return RecordedReference(motion_file=str(path)).evaluate(0.0)


def _controller(path):
    with trusting_code():
        return PythonOptions(system=f"{path}:Mine").construct({})


KINDS = {
    "scenario": Kind("own.yaml", _scenario, load_scenario),
    "sweep": Kind("own.yaml", lambda _: SWEEP, load_sweep),
    "comparison": Kind("own.yaml", lambda _: COMPARISON, load_comparison),
    "weights": Kind("own.json", lambda _: make_network().to_bytes(), load_network),
    "weights, sealed anew": Kind("own.json", lambda _: make_network().to_bytes(), load_network, _resealed_json),
    "dataset": Kind("own.parquet", _dataset, load_dataset),
    "log": Kind("own.parquet", _log, load_log),
    "log, sealed anew": Kind("own.parquet", _log, load_log, _resealed_parquet),
    "recording, csv": Kind("own.csv", _csv, _recording),
    "recording, parquet": Kind("own.parquet", _parquet, _recording),
    "controller": Kind("own.py", lambda _: CONTROLLER, _controller),
    "digest": Kind("own.json", lambda _: b"{}", digest),
}
"""One entry for each loader of files."""

HUGE = [b"9" * 400, b"9" * 5000, b"0x" + b"f" * 5000, b"1e999", b"-1e-999", b"9" * 100_000, b".nan", b"NaN", b"-1"]
DEEP = [b"[" * 5000, b"{a: " * 5000, b"(" * 5000, b"- " * 5000, b"-" * 50_000, b'{"a":' * 50_000, b"[" * 200_000]


def mutated(content, rng):
    """The content with one to three things wrong with it."""
    content = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        start, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
        way = int(rng.integers(9))
        if way == 0:
            for place in rng.integers(0, 8 * len(content), rng.integers(1, 9)) if content else ():
                content[place // 8] ^= 1 << (place % 8)
        elif way == 1:
            del content[end:]
        elif way == 2:
            content[start:start] = rng.bytes(int(rng.integers(1, 200)))
        elif way == 3:
            content[end:end] = content[start:end] * int(rng.choice([1, 1, 3, 100]))
        elif way == 4:
            del content[start:end]
        elif way in (5, 6):
            numbers = list(re.finditer(rb"\d[\d.]*", content))
            texts = HUGE if way == 5 else DEEP
            if numbers:
                found = numbers[rng.integers(len(numbers))]
                content[found.start() : found.end()] = texts[rng.integers(len(texts))]
        elif way == 7:
            lines = content.split(b"\n")
            rng.shuffle(lines)
            content = bytearray(b"\n".join(lines))
        elif rng.random() < 0.1:
            content = bytearray(rng.bytes(int(rng.integers(0, 300))))
    return bytes(content)


def bombs(name, folder):
    """Files of few bytes that are large once they are unpacked."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = ("time", "roll", "pitch", "yaw", "x", "y", "z")
    if name.endswith(".csv"):
        yield ",".join(columns).encode() + b"," * 20_000_000 + b"\n1,2\n"
        yield ",".join(columns).encode() + b"\n" + b"0,0,0,0,0,0,0\n" * 3_000_000
        yield ",".join(columns).encode() + b'\n0,0,0,0,0,0,"' + b"x" * 20_000_000
    elif name.endswith(".parquet"):
        long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(50_000, np.int32)), ["x" * 1_000_000])
        for column in (pa.array(np.zeros(20_000_000)), long):
            pq.write_table(pa.table(dict.fromkeys(columns, column)), folder / "bomb", store_schema=False)
            yield (folder / "bomb").read_bytes()
    elif name.endswith(".yaml"):
        for entry in ("[{0},{0},{0}]", "{{<<: [{0}, {0}]}}"):
            links = [f"a{k}: &a{k} " + entry.format(f"*a{k - 1}") for k in range(1, 60)]
            yield "\n".join(["a0: &a0 {x: 1}", *links]).encode()
        yield b"a: [" + b"1," * 490_000 + b"]"


def strange(path):
    """Makes at `path`, one after the other, what is no file that can be read; says which."""
    for what, make in (
        ("pipe", os.mkfifo),
        ("device", lambda p: p.symlink_to("/dev/zero")),
        ("folder", Path.mkdir),
        ("link to nothing", lambda p: p.symlink_to(path.parent / "nothing")),
        ("link to itself", lambda p: p.symlink_to(p)),
        ("socket", lambda p: socket.socket(socket.AF_UNIX).bind(str(p))),
        ("larger than anything", lambda p: (p.touch(), os.truncate(p, 2**40))),
        ("unreadable", lambda p: p.touch(0o000)),
    ):
        make(path)
        # Root may read everything.
        user = os.geteuid()
        if what == "unreadable" and user == 0:
            os.seteuid(65534)
        yield what
        os.seteuid(user)
        path.rmdir() if path.is_dir() else path.unlink()


def refused(kind, path):
    """Whether a file is refused by one line; anything but that and loading it is an AssertionError."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(10 * SECONDS)
    try:
        kind.load(path)
        return False
    except ConfigurationError as error:
        lines = str(error).split("\n")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
    # A line for each problem, of which some sixteen are told.
    assert len(lines) < 20, lines
    for line in lines:
        assert line.isprintable(), line
        assert len(line) < 2000, line
    return True


def attack(name, folder, seed=1):
    """Counts of files that were refused and of those that could be loaded."""
    kind = KINDS[name]
    path = folder / kind.name
    good = kind.make(path)
    path.write_bytes(good)
    assert not refused(kind, path)
    used = int(re.search(r"VmSize:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    rng = np.random.default_rng(seed)
    contents = [b"", *(kind.reseal(mutated(good, rng)) for _ in range(ROUNDS))]
    counts = [0, 0]
    for content in (*contents, *bombs(kind.name, folder)):
        path.write_bytes(content)
        counts[refused(kind, path)] += 1
    path.unlink()
    for what in strange(path):
        assert refused(kind, path) or kind.load(path) is None, what
    return counts


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for number, kind_name in enumerate(KINDS):
        place = Path(sys.argv[1]) / str(number)
        place.mkdir()
        # A process of its own, for its limits, but without importing all of it again.
        child = os.fork()
        if child == 0:
            loaded, not_loaded = attack(kind_name, place, *map(int, sys.argv[2:]))
            (place / "counts").write_text(json.dumps({"loaded": loaded, "refused": not_loaded}))
            sys.exit()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        found = json.loads((place / "counts").read_text()) if code == 0 else {}
        print(json.dumps({"kind": kind_name, "status": code, **found}), flush=True)
