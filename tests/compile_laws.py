"""Compiles the laws before several workers of pytest need them, each of which would compile them again.

python tests/compile_laws.py
"""

from concurrent.futures import ProcessPoolExecutor

from stewart_drake import load_scenario, run

SHORT = {"duration": 0.03}
ON = {name: {"plant.kind": name} for name in ("closed_form", "mujoco")}
# The two that compile most come first: two processes then share the work.
RUNS = (
    ("exact_heart", {}),
    ("reachy_slow_bus", {}),
    ("exact_breathing", {"tuner": "policy", "estimator": "observer", **ON["closed_form"]}),
    ("reachy_nod", {}),
    ("paper_fig7", ON["closed_form"]),
    ("exact_fig7", {"controller": {"kind": "pid"}, **ON["mujoco"]}),
    ("exact_fig7", {"controller": {"kind": "computed_torque"}, "sensors": "encoders", **ON["closed_form"]}),
    ("reachy_look_around", {}),
)


def compile_by(name, changes):
    run(load_scenario(name).replace(SHORT | changes), check=False)


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        list(pool.map(compile_by, *zip(*RUNS, strict=True)))
