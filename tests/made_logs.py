"""Logs made by hand, with known answers; shared by the tests of logs, metrics and outputs."""

import numpy as np

from stewart_drake import Scenario, SimulationLog
from stewart_drake.logs.signals import SIGNALS

STATES = tuple(f"motor_{i}_q" for i in range(6)) + ("platform_qw", "platform_z", "platform_wx")


def made_log(rows=101, step=0.1, duration=10.0, scenario=None, **changes):
    scenario = Scenario.from_dict({"name": "made", "duration": duration, "tuner": {"kind": "fixed"}} | (scenario or {}))
    widths = {"plant_state": len(STATES)} | {name: len(s.components) for name, s in SIGNALS.items() if s.components}
    signals = {name: np.zeros((rows, widths[name]) if name in widths else rows) for name in SIGNALS}
    signals["time"] = step * np.arange(rows)
    signals["weights"] += 1.0
    signals |= {name: changes.pop(name) for name in list(changes) if name in signals}
    end = float(signals["time"][-1]) if rows else 0.0
    attributes = {"end_time": end, "wall_time": 2.0, "versions": {"python": "3", "git_revision": "abc"}} | changes
    return SimulationLog(scenario, signals, STATES, **attributes)
