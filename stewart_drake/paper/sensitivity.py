"""The conclusion's sensitivity and robustness: (37), (38) with one change at a time; the sizes are ours."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.control.network import TunerNetwork
from stewart_drake.control.tuners import PaperTuner
from stewart_drake.paper.reproduce import Claim, Reproduction, Result, outcome, pair_of, paper_scenario, score
from stewart_drake.plotting.style import chart
from stewart_drake.scenario.scenario import Scenario

DURATION = 6.28  # [s] two periods of (37), (38), the second of which gives the error
BLOWN_UP = 2.0  # Factor on the pose RMSE beyond which a completed run counts as blown up
QUICK = (
    ("masses", "-20 %"),
    ("masses", "+20 %"),
    ("motor friction", "0.05 N m"),
    ("sample time", "10 ms"),
    ("omega_Q", "-50 %"),
    ("omega_Q", "+50 %"),
)


def scaled_network(network: TunerNetwork, omega_q: float = 1.0, omega_r: float = 1.0) -> TunerNetwork:
    factors = np.array([omega_q, omega_r])
    return replace(
        network,
        output_bias=network.output_bias + np.log10(factors),
        omega_min=network.omega_min * factors,
        omega_max=network.omega_max * factors,
    )


def changes(base: Scenario, folder: Path) -> dict[tuple[str, str], dict[str, object]]:
    """Factor and its new value -> keys of the scenario; bodies of the robot change, the model does not."""
    robot, model = base.robot, {"model.robot": base.controller_model.robot.to_dict()}
    network, window = base.tuner.network(), isinstance(base.tuner, PaperTuner)

    def bodies(name: str, factor: float) -> dict[str, object]:
        keys = [f"{body}_{name}" for body in ("platform", "rod", "crank")]
        return model | {f"robot.{key}": (factor * np.array(getattr(robot, key))).tolist() for key in keys}

    def weight(name: str, factor: float) -> dict[str, object]:
        if network is None:
            return {f"tuner.{name}": factor * getattr(base.tuner, name)}
        path = folder / f"tuner-{name}-{factor:g}.json"
        scaled_network(network, **{name: factor}).save(path)
        return {"tuner.weights_file": str(path.absolute())}

    def rods(step: float) -> dict[str, object]:
        return model | {"robot.rod_length": (np.array(robot.rod_length) + 1e-3 * step).tolist()}

    def percent(factor: float) -> str:
        return f"{100.0 * (factor - 1.0):+.0f} %"

    return {
        **{("masses", percent(f)): bodies("mass", f) for f in (0.8, 0.95, 1.05, 1.2)},
        **{("inertias", percent(f)): bodies("inertia", f) for f in (0.8, 1.2)},
        **{("rod length", f"{step:+g} mm"): rods(step) for step in (-1.0, 1.0)},
        **{("motor friction", f"{f:g} N m"): {"plant.motor_friction": f} for f in (0.0, 0.02, 0.05)},
        **{("motor damping", f"{d:g} N m s/rad"): {"plant.motor_damping": d} for d in (0.0, 0.05)},
        **{("sample time", f"{p:g} ms"): {"controller.period": 1e-3 * p} for p in (1.0, 2.0, 5.0, 10.0)},
        **{("window m", str(m)): {"tuner.window": m} for m in (10, 25, 49, 100, 200) if window},
        **{("omega_Q", percent(f)): weight("omega_q", f) for f in (0.5, 1.5)},
        **{("omega_R", percent(f)): weight("omega_r", f) for f in (0.5, 1.5)},
    }


def reproduce(study: Reproduction) -> Result:
    base, duration = study.base, study.pick(DURATION, 0.5 * DURATION)
    ratios = study.pick((1.0, 100.0), (1.0,))
    fixed = {
        f"ratio {ratio:g}": paper_scenario(base, duration, base.gravity_in_base, base.lqi.feedforward, pair_of(ratio))
        for ratio in ratios
    }
    controllers = {"tuner": study.under_tuner(fixed["ratio 1"]), **fixed}
    scenarios: dict[tuple[str, tuple[str, str] | None], Scenario] = {
        (name, None): scenario for name, scenario in controllers.items()
    }
    with TemporaryDirectory() as folder:
        for name, scenario in controllers.items():
            for change, keys in changes(scenario, Path(folder)).items():
                changed = scenario.replace(keys)
                if changed != scenario and (change in QUICK or not study.quick):
                    scenarios[name, change] = changed
        logs = study.run(scenarios, check=False)
    effects_of: Document = {
        name: {
            "unchanged": {"score": score(logs[name, None])},
            "effects": [
                {"factor": key[1][0], "to": key[1][1], "ended": outcome(log), "score": score(log)}
                for key, log in logs.items()
                if key[0] == name and key[1] is not None
            ],
        }
        for name in controllers
    }
    effects = [(of["unchanged"]["score"]["pose_mm"], effect) for of in effects_of.values() for effect in of["effects"]]
    early = sum(effect["score"] is None for _, effect in effects)
    blown = sum(effect["score"]["pose_mm"] > BLOWN_UP * size for size, effect in effects if effect["score"])
    claims = [
        Claim("V: changed runs that end early", "0", early, f"of {len(effects)}", early == 0),
        Claim("V: changed runs with twice the error", "0", blown, f"of {len(effects)}", blown == 0),
    ]
    curves = {}
    for name, of in effects_of.items():
        done = [effect for effect in of["effects"] if effect["score"]]
        rows = [f"{effect['factor']}, {effect['to']}" for effect in done]
        curves[name] = [effect["score"]["pose_mm"] for effect in done], rows
    title = "After each change; no mark where the run ends early"
    draw = partial(chart, title, "pose RMSE [mm]", "", curves, "o", "x", 7.0)
    return Result({"controllers": effects_of}, claims, {"sensitivity": draw})
