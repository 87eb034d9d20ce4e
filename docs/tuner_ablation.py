"""What each group of a policy's features is worth, and a preview: trainings without it, `make tuner_ablation`.

python docs/tuner_ablation.py runs/tuner-ablation     # writes docs/results/tuner_ablation.md; goes on where it stopped
"""

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import torch

from stewart_drake.campaigns.tables import markdown
from stewart_drake.control.policy import load_policy
from stewart_drake.runs.terminal import ProgressBar
from stewart_drake.training.policy_loops import PolicyInLoops, Situations
from stewart_drake.training.policy_training import PolicyOptions, Training, train_policy
from stewart_drake.training.situations import VALIDATION

RESULT = Path(__file__).parent / "results" / "tuner_ablation.md"
EPOCHS, SITUATIONS = 2, 10
AHEAD = 0.1
"""[s] of the preview."""
PREVIEW = f"all, the reference's speed and acceleration {AHEAD:g} s ahead"
VARIANTS = {
    "all thirteen": (),
    "densities": ("error_density", "torque_density"),
    "sizes of errors and torque changes": ("error", "error_slow", "torque_change"),
    "the observer's innovation": ("surprise", "surprise_slow", "drift"),
    "speed and acceleration of the reference": ("speed", "acceleration"),
    "noise and latency as believed": ("noise", "latency"),
    PREVIEW: (),
}
TEXT = """# What a policy's features are worth

`make tuner_ablation`: short trainings by the gradient ({epochs} epochs, {situations} situations of each kind and robot,
the same first weights), each without a group of features, and one that hears the reference of {ahead:g} s later in
place of now's. J over that of the best fixed setting at kappa 0, in {judged} situations of each kind that nothing was
trained on, batched loops with friction as it is; geometric means over the kinds.

{table}

A second training of all thirteen from other first weights: {again:.3f}. Differences smaller than between it and the
first row say nothing.
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


def training(preview: bool, **options) -> Training:
    """Of one variant."""
    seeds = options.pop("seeds", None)
    module = sys.modules[Training.__module__]
    module.Situations = WithPreview if preview else Situations
    return Training(PolicyOptions(**options), **({} if seeds is None else {"seeds": seeds}))


def by_kind(folder: Path, name: str, seed: int, tell) -> dict:
    """J over best fixed by robot and kind."""
    without, preview = VARIANTS[name], name == PREVIEW
    stem = f"{list(VARIANTS).index(name)}-{seed}"
    kept, file = folder / f"{stem}.json", folder / f"{stem}-policy.json"
    if not kept.exists():
        options = {"seed": seed, "epochs": EPOCHS, "situations": SITUATIONS, "without": without}
        policy = train_policy(training(preview, **options), folder / f"{stem}.checkpoint", tell)
        policy.save(file)
        judge = training(preview, situations=SITUATIONS, tastes=0.0, width=0.0, without=without, seeds=VALIDATION)
        kept.write_text(json.dumps(judge.by_kind(judge.begin(lambda _: None, load_policy(file)))))
    return json.loads(kept.read_text())


def main(folder: Path) -> None:
    """Writes the page."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = [(name, 0) for name in VARIANTS] + [("all thirteen", 1)]
    found = {}
    with ProgressBar("ablation", float(EPOCHS * len(runs)), quiet=False, unit="epochs") as advance:
        for k, (name, seed) in enumerate(runs):
            tell = partial(lambda k, name, done, word: advance(EPOCHS * k + done, f"{name}: {word}"), k, name)
            found[name, seed] = by_kind(folder, name, seed, tell)

    def mean(costs: dict, within: str = "") -> float:
        return float(np.exp(np.mean([np.log(value) for kind, value in costs.items() if kind.startswith(within)])))

    robots = ("paper", "reachy_mini")
    rows = [
        [
            name if name in ("all thirteen", PREVIEW) else f"without {name}",
            *(f"{mean(found[name, 0], robot):.3f}" for robot in ("", *robots)),
            "{1}, {0:.2f}".format(*max((value, kind) for kind, value in found[name, 0].items())),
        ]
        for name in VARIANTS
    ]
    text = TEXT.format(
        epochs=EPOCHS,
        situations=SITUATIONS,
        judged=SITUATIONS,
        ahead=AHEAD,
        again=mean(found["all thirteen", 1]),
        table="\n".join(markdown(["features", "all kinds", *robots, "worst kind"], rows)),
    )
    RESULT.write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
