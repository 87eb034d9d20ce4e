"""Scenarios at random, each from its seed: motions, controllers, friction, payloads, delays, sensors, pushes."""

import numpy as np

from stewart_drake.scenario import Scenario

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])


def random_scenario(seed):
    rng = np.random.default_rng(seed)
    duration = round(float(rng.uniform(1.5, 5.0)), 1)
    return Scenario.from_dict(
        {
            "name": f"random {seed}",
            "duration": duration,
            "plant": {
                "engine": "reduced",
                "motor_friction": 0.0 if rng.random() < 0.3 else between(rng, 0.005, 3.0),
                "payload_mass": 0.0 if rng.random() < 0.5 else between(rng, 0.05, 0.5),
                "payload_position": rng.uniform(-0.03, 0.03, 3).tolist(),
            },
            "reference": any_of(rng, (_sine, _breathing, _heart, _path, _bursts))(rng, duration),
            "initial_offset": (rng.uniform(-0.01, 0.01, 6) * (rng.random() < 0.3)).tolist(),
            "command_delay": int(rng.integers(0, 3)),
            **any_of(rng, (_paper, _paper, _exact, _others))(rng),
            **any_of(rng, (lambda _: {"sensors": {"kind": "ideal"}}, _encoders))(rng),
            "disturbances": [] if rng.random() < 0.6 else [_push(rng, duration)],
        }
    )


def between(rng, low, high):
    return float(low * (high / low) ** rng.random())


def any_of(rng, choices):
    return choices[int(rng.integers(len(choices)))]


def _size(rng):
    axes = rng.random(6) < 0.4
    axes[int(rng.integers(6))] = True
    sizes = [between(rng, 0.005, 0.15) for _ in range(3)] + [between(rng, 0.0005, 0.02) for _ in range(3)]
    return axes * rng.choice([-1.0, 1.0], 6) * sizes


def _sine(rng, _):
    return {
        "kind": "sine",
        "amplitude": _size(rng).tolist(),
        "angular_frequency": [between(rng, 1.0, 12.0)] * 6,
        "phase": rng.uniform(0.0, 2.0 * np.pi, 6).tolist(),
    }


def _breathing(rng, _):
    return {"kind": "breathing", "excursion": _size(rng).tolist(), "frequency": between(rng, 0.2, 0.6)}


def _heart(rng, duration):
    beat = {"kind": "heartbeat", "excursion": (0.5 * _size(rng)).tolist(), "rate": between(rng, 1.0, 1.8)}
    return {"kind": "sum", "parts": [beat, _breathing(rng, duration)]}


def _path(rng, duration):
    moves = int(rng.integers(1, 4))
    share = rng.uniform(0.2, 1.0) * duration / moves
    return {
        "kind": "minimum_jerk",
        "poses": [HOME.tolist(), *((HOME + _size(rng)).tolist() for _ in range(moves))],
        "durations": [0.7 * share] * moves,
        "dwell": [0.3 * share] * moves,
    }


def _bursts(rng, duration):
    count = int(rng.integers(1, 4))
    return {
        "kind": "sine_bursts",
        "frequency": [between(rng, 0.5, 3.0) for _ in range(count)],
        "amplitude": [(0.7 * _size(rng)).tolist() for _ in range(count)],
        "burst_duration": 0.3 * duration,
        "fade": 0.05 * duration,
    }


def _paper(rng):
    fixed = {"kind": "fixed", "omega_q": between(rng, 0.1, 10.0), "omega_r": between(rng, 0.1, 10.0)}
    feedforward = any_of(rng, ("gravity", "platform"))
    tuner = fixed if rng.random() < 0.7 else {"kind": "paper"}
    return {"controller": {"solver": "split", "feedforward": feedforward}, "tuner": tuner}


def _exact(rng):
    ranges = {"q_pose": (1e2, 1e6), "q_rate": (1.0, 100.0), "q_integral": (1.0, 1e8)}
    weights = {name: between(rng, *ends) for name, ends in ranges.items()}
    law = {"period": 0.001, "model": "exact", "weight_length": None, "solver": "split"}
    law |= {"feedforward": "full", "feedforward_at": "reference"}
    return {"controller": law, "tuner": {"kind": "block", **weights}}


def _others(rng):
    computed = {"kind": "computed_torque", "natural_frequency": between(rng, 2.0, 100.0), "damping": 0.8}
    return {"controller": any_of(rng, ({"kind": "pid"}, computed))}


def _encoders(rng):
    sensors = {"kind": "encoders", "resolution_bits": int(rng.integers(12, 18)), "noise": between(rng, 1e-6, 1e-4)}
    estimator = {"kind": any_of(rng, ("difference", "observer"))}
    return {"sensors": {**sensors, "noise_seed": int(rng.integers(1000)), "rate_cutoff": 150.0}, "estimator": estimator}


def _push(rng, duration):
    begin = rng.uniform(0.0, duration)
    wrench = [*rng.uniform(-0.1, 0.1, 3), *rng.uniform(-5.0, 5.0, 3)]
    return {"kind": "step", "wrench": wrench, "time": begin, "until": begin + rng.uniform(0.1, 2.0)}
