"""Betters a policy for the slow robot by evolution on the reduced engine, the last step of the shipped one.

python docs/tuner_polish.py runs/polish first.json second.json     # writes runs/polish/policy.json
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from stewart_drake.control.policy import load_policy
from stewart_drake.training.baselines import Baselines, always
from stewart_drake.training.contest import Contest, cases_of, cells_of, with_setting
from stewart_drake.training.situations import TRAINING, kinds_of

ROBOT, SEEDS = "reachy_mini", TRAINING[100:110]
"""Runs of the slow robot take a tenth of the time; the other one hardly notices the change."""
NAMES = ("hidden", "hidden_bias", "output", "output_bias")
SHARES = np.array([0.4, 0.3, 0.2, 0.1])
"""Of the four best in the middle of the next generation."""
GENERATIONS = ((18, 0.06), (14, 0.12), (14, 0.12), (0, 0.0))
"""Candidates around the middle, and how far off, as a share of each weight and of 0.1 at least."""
WORSE = 0.02
"""Logarithm of J over best fixed above which a kind counts twice."""


def flat(policy):
    """Its weights in a row."""
    return np.concatenate([np.ravel(getattr(policy.layers, name)) for name in NAMES])


def with_weights(policy, weights):
    """The policy with other weights."""
    ends = np.cumsum([0] + [np.size(getattr(policy.layers, name)) for name in NAMES])
    parts = {
        name: weights[start:end].reshape(np.shape(getattr(policy.layers, name)))
        for name, start, end in zip(NAMES, ends[:-1], ends[1:], strict=True)
    }
    return replace(policy, layers=policy.layers._replace(**parts))


def scores(contest, folder, policy, candidates):
    """What each costs: mean over kinds of log J over best fixed, and again what of it is above `WORSE`."""
    cases = cases_of([(kind, ROBOT) for kind in kinds_of(ROBOT, trained=True)], SEEDS)
    contestants = [with_setting(Baselines.load().best)]
    for k, weights in enumerate(candidates):
        file = folder / f"candidate-{k}.json"
        with_weights(policy, weights).save(file)
        contestants.append(always({"tuner": {"kind": "policy", "weights_file": str(file.absolute())}}))
    logs = contest.log_costs(contestants, cases)
    kinds = np.stack([(logs[1:, at] - logs[0, at]).mean(axis=1) for at in cells_of(cases).values()], axis=1)
    print(np.round(np.exp(kinds[np.argmin(kinds.mean(axis=1))]), 2), flush=True)
    return kinds.mean(axis=1) + np.maximum(0.0, kinds - WORSE).sum(axis=1)


def main(folder: Path, *files: str) -> None:
    """Writes policy.json."""
    folder.mkdir(parents=True, exist_ok=True)
    policies, rng = [load_policy(file) for file in files], np.random.default_rng(0)
    middle = np.mean([flat(policy) for policy in policies], axis=0)
    with Contest(folder / "rows", "reduced") as contest:
        for count, spread in GENERATIONS:
            size = spread * np.maximum(np.abs(middle), 0.1)
            candidates = [middle, *(middle + size * rng.standard_normal(len(middle)) for _ in range(count))]
            order = np.argsort(scores(contest, folder, policies[0], candidates))[: len(SHARES)]
            if count:
                middle = SHARES @ np.array(candidates)[order]
    with_weights(policies[0], middle).save(folder / "policy.json")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
