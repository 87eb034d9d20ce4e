"""The films of docs/gallery.md, in docs/images/gallery, and the README's docs/images/robots.gif: `make pictures`."""

from pathlib import Path

import numpy as np
from PIL import Image

from stewart_drake import load_scenario, run
from stewart_drake.runs.pictures import film_frames, save_film
from stewart_drake.studies.faults import FAULTS, base

IMAGES = Path(__file__).parents[1] / "images"
WIDTH = 400  # [px] of one robot


def film(scenario, first=0.0, frames_per_second=20.0):
    """The pictures of a run, whatever became of it, from a time [s] on."""
    frames, rate = film_frames(run(scenario, check=False), frames_per_second=frames_per_second, width=WIDTH)
    return frames[round(first * rate) :]


def beside(*films):
    """Films as one, side by side."""
    return [Image.fromarray(np.hstack([np.asarray(frame) for frame in row])) for row in zip(*films, strict=True)]


def save(name, frames, rate=20.0):
    """Writes a film, `rate` frames a second."""
    save_film(frames, rate, IMAGES / f"{name}.gif")


def main():
    """Writes all of them."""
    paper = ["reference.angular_frequency=2.0943951023931953", "duration=6"]  # two periods of 3 s
    looks = film(load_scenario("reachy_look_around"))
    save("robots", beside(looks, film(load_scenario("exact_fig7", paper))))

    period = np.pi  # [s] of the paper's motion
    films = [film(load_scenario(name, [f"duration={2.0 * period}"]), period) for name in ("paper_fig7", "exact_fig7")]
    save("gallery/network_and_exact", beside(*films))
    save("gallery/heart", film(load_scenario("exact_heart", ["duration=3.3"])))
    save("gallery/tool_path", film(load_scenario("tool_path", ["duration=7"])))
    save("gallery/hexapod", film(load_scenario("sway", ["robot=servo_hexapod", f"duration={4.0 * np.pi / 3.0}"])))
    save("gallery/dead_centre", film(load_scenario("paper_fig7_uncompensated"), frames_per_second=200.0), 10.0)
    start = base()
    dead = start.replace(FAULTS["dead_motor_3"].in_motion("breathing", start) | {"duration": 1.4})
    save("gallery/dead_motor", film(dead, 0.4, 100.0), 20.0)


if __name__ == "__main__":
    main()
