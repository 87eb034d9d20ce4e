"""Logs made by hand, with known answers; shared by the tests of logs, metrics and outputs."""

import io

import numpy as np

from stewart_drake.files.parquet_files import SealedWriter
from stewart_drake.logs.log import SIGNALS, SimulationLog
from stewart_drake.scenario import Scenario

STATES = 49


def made_log(rows=101, step=0.1, duration=10.0, scenario=None, **changes):
    """A log of `rows` rows, `step` apart, zero but for time and weights; `changes` replaces signals or attributes."""
    scenario = Scenario.from_dict({"name": "made", "duration": duration, "tuner": {"kind": "fixed"}} | (scenario or {}))
    widths = {"plant_state": STATES} | {name: len(spec.components) for name, spec in SIGNALS.items() if spec.components}
    signals = {name: np.zeros((rows, widths.get(name, 0))) for name in SIGNALS}
    signals["time"] = step * np.arange(rows)
    signals["weights"] += 1.0
    signals |= {name: changes.pop(name) for name in list(changes) if name in signals}
    end = float(signals["time"][-1]) if rows else 0.0
    attributes = {"end_time": end, "wall_time": 2.0, "versions": {"python": "3", "git_revision": "abc"}} | changes
    return SimulationLog(scenario, signals, tuple(f"state {i}" for i in range(STATES)), **attributes)


def sealed(key, table, about):
    """A Parquet file with a good checksum, and another content than the package would give it."""
    stream = io.BytesIO()
    with SealedWriter(stream, table.schema, key, about) as writer:
        writer.write(table)
    return stream.getvalue()
