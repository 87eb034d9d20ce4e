"""How trainings of the policy compare, and what its features are worth: `make tuner_training`.

python docs/tuner_training.py runs/tuner-training gradient.json policy.json evolution.json

Writes docs/results/tuner_training.md, from the policies of `make tuner_policy` and trainings of its own; goes on where
it stopped.
"""

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import torch

from stewart_drake.campaigns.tables import markdown
from stewart_drake.control.policy import load_policy
from stewart_drake.files.whole import checksum
from stewart_drake.runs.terminal import ProgressBar
from stewart_drake.training.policy_loops import PolicyInLoops, Situations
from stewart_drake.training.policy_options import PolicyOptions
from stewart_drake.training.policy_training import Training, train_policy
from stewart_drake.training.situations import ROBOTS, VALIDATION

RESULT = Path(__file__).parent / "results" / "tuner_training.md"
EPOCHS, SITUATIONS, JUDGED = 2, 10, 20
AHEAD = 0.1
"""[s] of the preview."""
PREVIEW = f"all, the reference's speed and acceleration {AHEAD:g} s ahead"
VARIANTS = {
    "all thirteen": (),
    "densities": ("error_density", "torque_density"),
    "sizes of errors and torque changes": ("error", "error_slow", "torque_change"),
    "the observer's innovation": ("surprise", "surprise_slow", "drift"),
    PREVIEW: (),
}
TEXT = """# How the policy is trained, and what its features are worth

`make tuner_policy tuner_training`. J over that of the best fixed setting at kappa 0, in {judged} situations of each
kind and robot that nothing was trained on, in batched loops with friction as it is; geometric means over the kinds.

## Trainings

*Gradient*: backpropagation through the loops. *Evolution*: an evolution strategy on whole runs, each loop with a pair
of directions of its own. Epochs: J over best fixed during each, on the situations of the training itself.

{trainings}

## Features

Short trainings by the gradient ({epochs} epochs, {situations} situations of each kind and robot, the same first
weights), each without a group of features, and one that hears the reference {ahead:g} s ahead of now.

{features}

A second training of all thirteen from other first weights: {again:.3f}. Differences smaller than between it and the
first row say nothing. So every group pays and the preview does not, but for the paper's robot alone little is certain:
most of it is Reachy Mini, whose restlessness these short trainings do not get rid of.
"""


class Ahead(PolicyInLoops):
    """Hears the reference as it will be."""

    path = torch.zeros(0)

    def __call__(self, seen, memory):
        """See there."""
        tick = int(memory.recent.ticks[0, 0])
        return super().__call__(seen._replace(reference=self.path[tick]), memory)


class WithPreview(Situations):
    """Runs in which a policy hears so."""

    def tuner(self, layers):
        """See there."""
        found = Ahead(layers, self.site)
        if not hasattr(self, "path"):
            times = self.site.period * np.arange(self.ticks) + AHEAD
            paths = [np.concatenate(each.reference.evaluate(times), axis=-1) for each in self.scenarios]
            self.path = torch.from_numpy(np.stack(paths, axis=1))
        found.path = self.path
        return found


def judged(file: Path, kept: Path, runs: type[Situations] = Situations) -> dict:
    """J over best fixed by robot and kind, of a policy in situations of which it has seen none."""
    if not kept.exists():
        options = PolicyOptions(situations=JUDGED, tastes=0.0, width=0.0)
        judge, own = Training(options, seeds=VALIDATION, runs=runs), load_policy(file).layers
        centre = own._replace(output=0.0 * own.output, output_bias=0.0 * own.output_bias)
        kept.write_text(json.dumps(judge.by_kind(judge.costs(own), judge.costs(centre))))
    return json.loads(kept.read_text())


def variant(folder: Path, name: str, seed: int, tell) -> dict:
    """The same of a short training."""
    runs = WithPreview if name == PREVIEW else Situations
    stem = f"{list(VARIANTS).index(name)}-{seed}"
    file = folder / f"{stem}.json"
    if not file.exists():
        options = PolicyOptions(seed=seed, epochs=EPOCHS, situations=SITUATIONS, without=VARIANTS[name])
        train_policy(Training(options, runs=runs), folder / f"{stem}.checkpoint", tell).save(file)
    return judged(file, folder / f"{stem}-judged.json", runs)


def mean(costs: dict, within: str = "") -> float:
    """Geometric mean over the kinds of a robot, or of all."""
    return float(np.exp(np.mean([np.log(value) for kind, value in costs.items() if kind.startswith(within)])))


def row(name: str, costs: dict) -> list[str]:
    """Of a table."""
    worst = max(costs, key=lambda kind: costs[kind])
    return [name, *(f"{mean(costs, robot):.3f}" for robot in ("", *ROBOTS)), f"{worst} {costs[worst]:.2f}"]


def main(folder: Path, *files: str) -> None:
    """Writes the page."""
    folder.mkdir(parents=True, exist_ok=True)
    trainings = []
    for file in files:
        policy = load_policy(file)
        card, seconds = policy.provenance, policy.provenance["processor_seconds"]
        first = card.get("start")
        name = card["options"]["method"] if first is None else f"{first['options']['method']}, then evolution"
        seconds += 0 if first is None else first["processor_seconds"]
        kept = folder / f"{checksum(policy.to_bytes().decode())[:12]}.json"
        epochs = " ".join(f"{value:.2f}" for value in card["epochs_J_over_best_fixed"])
        trainings.append([*row(name, judged(Path(file), kept)), f"{seconds}", epochs])
    runs, found = [(name, 0) for name in VARIANTS] + [("all thirteen", 1)], {}
    with ProgressBar("short trainings", float(EPOCHS * len(runs)), quiet=False, unit="epochs") as advance:
        for k, (name, seed) in enumerate(runs):
            tell = partial(lambda k, name, done, word: advance(EPOCHS * k + done, f"{name}: {word}"), k, name)
            found[name, seed] = variant(folder, name, seed, tell)
    header = ["all kinds", *(f"{robot} alone" for robot in ROBOTS), "worst kind"]
    rows = [row(name if name in ("all thirteen", PREVIEW) else f"without {name}", found[name, 0]) for name in VARIANTS]
    text = TEXT.format(
        judged=JUDGED,
        trainings="\n".join(markdown(["training", *header, "processor, epochs alone [s]", "epochs"], trainings)),
        epochs=EPOCHS,
        situations=SITUATIONS,
        ahead=AHEAD,
        features="\n".join(markdown(["features", *header], rows)),
        again=mean(found["all thirteen", 1]),
    )
    RESULT.write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
