"""Runs at random, each from its seed: motions, controllers, friction, payloads, delays, sensors, pushes."""

from collections import Counter

import numpy as np
import pytest

from stewart_drake import Scenario, run

RUNS, PARTS = 90, 3
HERE = [pytest.param(part, marks=[pytest.mark.long] if part else []) for part in range(PARTS)]
LQI = {"period": 0.001, "model": "exact", "weight_length": None, "solver": "split", "feedforward": "full"}


def random_scenario(seed):
    rng = np.random.default_rng(seed)

    def between(low, high):
        return float(low * (high / low) ** rng.random())

    def one_of(*choices):
        return choices[rng.integers(len(choices))]

    duration, begin = round(float(rng.uniform(1.5, 5.0)), 1), rng.uniform(0.0, 1.5)
    moving = rng.random(6) < 0.4
    moving[rng.integers(6)] = True
    sizes = [between(0.005, 0.15) for _ in range(3)] + [between(0.0005, 0.02) for _ in range(3)]
    size = (moving * rng.choice([-1.0, 1.0], 6) * sizes).tolist()
    ranges = {"q_pose": (1e2, 1e6), "q_rate": (1.0, 100.0), "q_integral": (1.0, 1e8)}
    block = {"kind": "block", **{name: between(*ends) for name, ends in ranges.items()}}
    fixed = {"kind": "fixed", "omega_q": between(0.1, 10.0), "omega_r": between(0.1, 10.0)}
    paper = {"controller": {"solver": "split", "feedforward": one_of("gravity", "platform")}}
    computed = {"kind": "computed_torque", "natural_frequency": between(2.0, 100.0), "damping": 0.8}
    bits, noise = int(rng.integers(12, 18)), between(1e-6, 1e-4)
    encoders = {"kind": "encoders", "resolution_bits": bits, "noise": noise}
    push = {"kind": "step", "wrench": [0.0, 0.0, 0.0, *rng.uniform(-5.0, 5.0, 3)], "time": begin, "until": begin + 1.0}
    return Scenario.from_dict(
        {
            "duration": duration,
            "plant": {
                "kind": "closed_form",
                "motor_friction": one_of(0.0, between(0.005, 3.0)),
                "payload_mass": one_of(0.0, between(0.05, 0.5)),
            },
            "reference": one_of(
                {"kind": "sine", "amplitude": size, "angular_frequency": [between(1.0, 12.0)] * 6},
                {"kind": "breathing", "excursion": size, "frequency": between(0.2, 0.6)},
                {"kind": "sine_bursts", "frequency": [1.0], "amplitude": [size], "burst_duration": 0.5 * duration},
            ),
            "initial_offset": (rng.uniform(-0.01, 0.01, 6) * (rng.random() < 0.3)).tolist(),
            "command_delay": int(rng.integers(0, 3)),
            **one_of(
                {**paper, "tuner": fixed},
                {**paper, "tuner": {"kind": "paper"}},
                {"controller": LQI, "tuner": block},
                {"controller": one_of({"kind": "pid"}, computed)},
            ),
            "sensors": one_of({"kind": "ideal"}, encoders),
            "estimator": one_of({"kind": "difference", "rate_cutoff": 150.0}, {"kind": "observer"}),
            "disturbances": one_of([], [push]),
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize("part", HERE)
def test_no_completed_run_of_90_is_worse_than_standing_still(part):
    ends = Counter()
    for seed in range(part, RUNS, PARTS):
        log = run(random_scenario(seed))
        ends[log.status, log.reason] += 1
        scale = np.array([0.11] * 3 + [1.0] * 3)
        reference, pose = scale * log["reference"], scale * log["pose"]
        motion, moved = (np.sqrt(np.sum((each - each.mean(axis=0)) ** 2, axis=1).mean()) for each in (reference, pose))
        error, start = np.sqrt(np.sum((pose - reference) ** 2, axis=1)), scale * (log["pose"] - log["reference"])[0]
        whole = np.sqrt(np.mean(error**2)) / (motion + np.linalg.norm(start))
        if log.status == "completed" and motion > 0.33e-3:
            assert whole <= 1.0, seed
            assert moved >= 0.2 * motion, seed
            assert whole <= 0.5 or "poorly_followed" in {warning["name"] for warning in log.warnings}, seed
    assert min(ends["completed", None], ends["lost", "not_followed"]) >= 3
