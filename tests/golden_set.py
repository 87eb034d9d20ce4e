"""The contract: what the package computes, recorded, so that a rewrite can be checked against it step by step.

    python tests/golden_set.py record tests/golden   # by whichever stewart_drake Python finds; some ten minutes
    python tests/golden_set.py compare OLD NEW       # what differs, the worst first; status 1 if anything does
    python tests/golden_set.py check [SETTING ...]   # computes anew and compares with tests/golden; of processors.py

The cases are data, in golden/cases.yaml; the recording is golden/numbers.json (outcomes, metrics, tables) and
golden/signals.npz (some twenty rows of each run, the last among them).

Processors round differently, and some cases amplify that: a loop that diverges, a density with a mean near zero, a
verdict on the edge. So a recording is made twice, the second time with the arithmetic of an old processor. What the two
differ by is how sensitive a number is to rounding; `MARGIN` times as much is its tolerance, in golden/sensitive.json,
where that is more than the usual one. A text, or a number of rows, that differs is not compared.
"""

import csv
import fnmatch
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # sums in one order

import numpy as np
import yaml
from processors import SETTINGS

import stewart_drake as sd
from stewart_drake.analysis.feasibility import amplitude_table, largest_scale
from stewart_drake.analysis.workspace import measure_poses
from stewart_drake.mechanics import dynamics, friction, kinematics
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque, task_inertia
from stewart_drake.mechanics.kinematics import inverse_kinematics, leg_geometry, pose_rate_to_twist, rotation_matrix

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "tests" / "golden"
ROWS = 20
MARGIN = 100.0

SIGNALS = (
    *("time", "pose", "pose_rate", "reference", "reference_rate", "reference_acceleration", "error", "integral"),
    *("torque", "torque_applied", "crank_angle", "weights", "block_weights", "setting", "density", "loop_gap"),
    *("measured_pose", "measured_pose_rate", "innovation", "disturbance", "safety"),
)

# Name -> absolute tolerance, and relative to the largest number of the signal or list; the first that fits counts.
TOLERANCES = (
    ("*/pose", 1e-9, 0.0),
    ("*/reference", 1e-9, 0.0),
    ("*/measured_pose", 1e-9, 0.0),
    ("*/error", 1e-9, 0.0),
    ("*/crank_angle", 1e-9, 0.0),
    ("*/torque", 0.0, 1e-8),
    ("*/torque_applied", 0.0, 1e-8),
    ("mechanics/*", 0.0, 1e-9),
    ("*_mm*", 1e-6, 1e-6),  # what 1e-9 of a pose makes of a metric
    ("*_deg*", 6e-8, 1e-6),
    ("*", 1e-12, 1e-6),
)

# Keys of what tells about a machine, or in words.
PASSING = {
    *("files", "git_revision", "host", "message", "poses_per_second", "real_time_factor", "scenario"),
    *("sha256", "simulation_s", "source", "text", "values", "versions", "wall_s", "worker"),
}


@lru_cache
def cases():
    return yaml.safe_load((GOLDEN / "cases.yaml").read_text())


def run_case(group, name, kind=None):
    data = dict(cases()[group][name])
    if group == "shipped":
        shipped = data.pop("scenario")
        scenario = sd.load_scenario(shipped, [f"{key}={json.dumps(value)}" for key, value in data.items()])
    else:
        scenario = sd.Scenario(**{**data, "plant": {**data.get("plant", {}), "kind": kind}})
    log = sd.run(scenario, check=False)
    found = {"metrics": sd.run_metrics(log)}
    for signal in filter(log.__contains__, SIGNALS):
        stride = max(1, (len(log[signal]) - 1) // ROWS)
        found[signal] = np.concatenate([log[signal][:-1:stride], log[signal][-1:]])
    return found


def motions(group):
    times, given = np.linspace(0.0, 4.0, 41), cases()[group].items()
    if group == "references":
        return {name: np.hstack(sd.Scenario(reference=data).reference.evaluate(times)) for name, data in given}
    return {name: sd.Scenario(disturbances=[data]).disturbances[0].evaluate(times) for name, data in given}


def robots():
    legs = [{"rod_length": 0.41}, {}, {"crank_length": 0.105}, {"platform_joint": [-0.09, 0.05, 0.004]}, {}, {}]
    own = {"legs": legs, "platform_center_of_mass": [0.003, -0.002, 0.004], "rotor_inertia": 1e-5}
    chosen = {name: sd.load_robot(name) for name in ("paper", "reachy_mini", "servo_hexapod")}
    for name, robot in {**chosen, "uneven": sd.RobotParameters(**own)}.items():
        size = np.array([1.0] * 3 + [robot.characteristic_length] * 3)
        pose, rate, acceleration = size * np.random.default_rng(7).uniform(-1.0, 1.0, (3, 3, 4, 6))
        yield name, robot, robot.home_pose + 0.1 * pose, rate, 10.0 * acceleration


def mechanics():
    found = {}
    for name, robot, pose, rate, acceleration in robots():
        legs, rpy = leg_geometry(robot, pose), pose[..., :3]
        angles, twist = inverse_kinematics(robot, pose), pose_rate_to_twist(pose, rate)
        rotation, inertia = rotation_matrix(rpy), task_inertia(robot, pose)
        torque = inverse_dynamics(robot, pose, rate, acceleration)
        own = {key: getattr(legs, key) for key in ("rotation", "arm", "crank", "e_n", "e_l", "transmission")}
        own |= {"inverse_kinematics": angles, "pose_rate_to_twist": twist, "rotation_matrix": rotation}
        own |= {"task_inertia": inertia, "inverse_dynamics": torque}
        calls = (
            (inverse_kinematics, robot.replace(branch=1), robot.home_pose),
            (kinematics.forward_kinematics, robot, angles, robot.home_pose),
            (kinematics.rotation_angle, rotation),
            (kinematics.roll_pitch_yaw, rotation),
            (kinematics.euler_rate_matrix, rpy),
            (euler_rate_matrix_dot, rpy, rate[..., :3]),
            (kinematics.twist_to_pose_rate, pose, twist),
            (kinematics.reach_margin, robot, pose),
            (kinematics.conditioning, robot, pose),
            (line_conditioning, robot, legs),
            (kinematics.rod_lines, legs),
            (dynamics.rod_map, legs),
            (dynamics.crank_map, robot, legs, "statics"),
            (dynamics.crank_map, robot, legs, "printed"),
            (dynamics.force_map, robot, pose),
            (dynamics.force_map_of_legs, robot, legs, "printed"),
            (kinematics.crank_rates, robot, legs, pose, rate),
            (kinematics.twist_jacobian, robot, pose),
            (kinematics.pose_jacobian, robot, pose),
            (static_torque, robot, pose),
            (static_torque, robot, pose, 3.7),
            (dynamics.task_bias, robot, pose, twist),
            (dynamics.pose_acceleration_map, robot, pose),
            (dynamics.forward_dynamics, robot, pose, rate, torque),
        )
        own |= {f"{at}_{function.__name__}": function(*given) for at, (function, *given) in enumerate(calls)}
        own["friction"] = motor_friction(angles, rate, np.linalg.inv(inertia))
        found[name] = own
    return found


def euler_rate_matrix_dot(rpy, rate):
    sp, cp, sy, cy = np.sin(rpy[..., 1]), np.cos(rpy[..., 1]), np.sin(rpy[..., 2]), np.cos(rpy[..., 2])
    pitch, yaw = rate[..., 1], rate[..., 2]
    none = np.zeros_like(pitch)
    rows = (
        (-sy * cp * yaw - cy * sp * pitch, -cy * yaw, none),
        (cy * cp * yaw - sy * sp * pitch, -sy * yaw, none),
        (-cp * pitch, none, none),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def line_conditioning(robot, legs):
    lines = kinematics.rod_lines(legs) / ([robot.characteristic_length] * 3 + [1.0] * 3)
    sigma = np.linalg.svd(lines, compute_uv=False)
    return sigma[..., -1] / sigma[..., 0]


def motor_friction(angles, rate, mobility):
    levels = {"coulomb": 0.02, "break_away": 0.03, "stribeck_velocity": 0.01, "viscous": 0.005}
    stiffness = friction.bristle_stiffness(np.linspace(2e-4, 3e-4, 6), 1e-3)
    law = friction.FrictionOptions.from_dict(levels).record(stiffness, 1e-3)[0]
    found = {"anchor": angles.copy(), "implicit_torque": np.empty_like(angles)}
    for row in np.ndindex(angles.shape[:-1]):
        bristles = np.zeros(1, [("anchor", float, 6), ("slip", float, 6)])
        bristles["anchor"] = angles[row]
        friction.update_bristles(law, angles[row] + 0.01 * rate[row], 1e-3, bristles["anchor"][0], bristles["slip"][0])
        torque = found["implicit_torque"][row]
        friction.implicit_torque(law, bristles[0], angles[row], rate[row], mobility[row], 1e-3, 30, torque)
        found["anchor"][row] = bristles["anchor"][0]
    return found


def planning():
    paper = sd.load_scenario("paper_fig7")
    of_paper = paper.robot, paper.limits

    def scaled(scale, height=0.05):
        return sd.load_scenario("paper_fig7", [f"reference.amplitude=[{scale}, 0, 0, 0, 0, {height}]"]).reference

    smallest = sd.check_reference(*of_paper, paper.reference, 4.0).smallest
    first = sd.check_reference(*of_paper, scaled(1.0, 0.1), 4.0).first_violation
    found = {
        "smallest": {name: [each.margin, each.time, each.leg] for name, each in smallest.items()},
        "first_violation": [first.limit, first.margin, first.time, first.leg],
        "amplitude_table": amplitude_table(*of_paper, [0.0, 1.0, 3.0], paper.gravity),
        "largest_scale": largest_scale(*of_paper, scaled, 4.0, paper.gravity),
    }
    keys = ("transmission", "conditioning", "ball_swing", "universal_swing", "clearance", "holding_torque")
    for name, robot, pose, _, _ in robots():
        measured = measure_poses(robot, pose.reshape(-1, 6))
        found[name] = {key: getattr(measured, key) for key in (*keys, "force", "moment")}
        found[name]["reach"] = measured.reach_margin
    return found


def calibration():
    robot, poses = sd.load_robot("servo_hexapod"), ROOT / "diagrams" / "calibration" / "poses.csv"
    noise = sd.MeasurementNoise(encoder=2.0 * math.pi / 2**14 / math.sqrt(12.0))

    def fitted(*hold, fit=None):
        result = sd.calibrate(robot, poses, noise, hold=hold, fit=fit)
        values = np.array([row[-2:] for row in result.rows()])
        sizes = {"noise_ratio": result.noise_ratio, "error_sizes": result.error_sizes()}
        return {"value": values[:, 0], "half_width": values[:, 1], **sizes}

    plan = sd.plan_poses(robot, 20, noise=noise, candidates=200)
    planned = {"angles": plan.targets.angles, "half_width": plan.half_width, "gain": plan.gain}
    return {"all": fitted(), "held": fitted("crank_length", "rod_length", fit="geometry"), "plan": planned}


def identification():
    guess = sd.RobotParameters()
    true = sd.RobotParameters(platform_mass=1.2, platform_center_of_mass=[0.01, 0.0, 0.02], rod_mass=0.09)
    designed = sd.excite(guess, seed=2, changes=30)
    time = np.arange(0.0, 8.0, 0.004)
    motion = designed.reference.evaluate(time)
    angles = inverse_kinematics(guess, motion[0])
    rates = np.einsum("nij,nj->ni", kinematics.pose_jacobian(guess, motion[0]), motion[1])
    friction = 0.03 * np.tanh(rates / 0.01) + 0.01 * rates
    noise = np.random.default_rng(1).normal(0.0, 0.002, angles.shape)
    torque = inverse_dynamics(true, *motion) + friction + noise
    result = sd.identify(guess, [sd.Recording(time, angles, torque)])
    values = np.array([row[4:6] for row in result.rows()])
    predictions = [[each.guess, each.identified, each.everywhere] for each in result.predictions]
    return {
        "excitation": {"condition": designed.condition, "random_condition": designed.random_condition},
        "motion": np.hstack(motion)[::100],
        "value": values[:, 0],
        "half_width": values[:, 1],
        "predictions": predictions,
    }


def command(arguments, writes):
    with tempfile.TemporaryDirectory() as folder:
        out, words = Path(folder) / "out", [str(each) for each in arguments]
        if words[1] in ("sweep", "comparison"):
            words[1] = str(Path(folder) / f"{words[1]}.yaml")
            Path(words[1]).write_text(json.dumps(cases()[arguments[1]]))
        call = [sys.executable, "-m", "stewart_drake", *words, "--out", str(out), "--quiet"]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr)
        return {name: read(out / name) for name in writes}


def as_number(text):
    try:
        return float(text)
    except ValueError:
        return text


def read(path):
    if path.suffix == ".json":
        document = json.loads(path.read_text())
        return document.get("numbers", document)
    with path.open(newline="") as stream:
        return [{key: as_number(cell) for key, cell in row.items()} for row in csv.DictReader(stream)]


def jobs():
    own = cases()
    found = {f"commands/{name}": (command, each["of"], each["writes"]) for name, each in own["commands"].items()}
    found["commands/sweep"] = (command, ["sweep", "sweep", "--workers", 1], ["sweep.csv"])
    compared = ["comparison.csv", "bands.csv"]
    found["commands/comparison"] = (command, ["compare", "comparison", "--workers", 1], compared)
    found |= {name: (globals()[name],) for name in ("mechanics", "planning", "calibration", "identification")}
    found |= {name: (motions, name) for name in ("references", "disturbances")}
    found |= {f"shipped/{name}": (run_case, "shipped", name) for name in own["shipped"]}
    # Where the numbers of the closed form stand is older than its name.
    for place, kind in (("drake", "drake"), ("reduced", "closed_form")):
        found |= {f"runs/{name}/{place}": (run_case, "runs", name, kind) for name in own["runs"]}
    return found | {f"runs/{name}/drake": (run_case, "on_drake", name, "drake") for name in own["on_drake"]}


def perform(function, *arguments):
    os.chdir(ROOT)  # paths among the cases are relative to it
    try:
        return function(*arguments)
    except Exception as error:
        return {"raised": f"{type(error).__name__}: {error}"}


def compute(folder):
    arrays, numbers = {}, {}
    with ProcessPoolExecutor(2) as pool:
        waiting = {key: pool.submit(perform, *job) for key, job in jobs().items()}
        for key, result in waiting.items():
            flatten(key, result.result(), arrays, numbers)
    write(folder, arrays, numbers)
    failed = [f"{key}: {text}" for key, text in numbers.items() if key.endswith("/raised")]
    print(*failed, sep="\n", end="\n" if failed else "", file=sys.stderr)
    return 1 if failed else 0


def compute_as(setting, folder):
    """Computes with the arithmetic of another processor, which only a new process can have."""
    arguments = [sys.executable, __file__, "compute", str(folder)]
    return subprocess.run(arguments, env=os.environ | SETTINGS[setting], check=False).returncode


def record(folder):
    with tempfile.TemporaryDirectory() as other:
        failed = compute(folder) or compute_as("oldest", other)
        if not failed:
            found = sensitive(recorded(folder), recorded(Path(other)))
            lines = [f"{json.dumps(key)}: {json.dumps(tolerance)}" for key, tolerance in found.items()]
            (folder / "sensitive.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    return failed


def sensitive(values, others):
    """Key -> tolerances, of each row of a signal or number of a list; infinite where there is nothing to compare."""
    found = {}
    for key in sorted(values.keys() | others.keys()):
        a, b = as_array(values.get(key)), as_array(others.get(key))
        if not comparable(a, b):
            found |= {} if as_text(values.get(key)) == as_text(others.get(key)) else {key: math.inf}
            continue
        size = MARGIN * distance(a, b)
        if isinstance(values[key], np.ndarray):  # what has once run apart stays so
            size = np.maximum.accumulate(size.reshape(len(size), -1).max(axis=1))
        if size.max(initial=0.0) > usual(key, a):
            found[key] = [float(f"{each:.2g}") for each in size]
    return found


def write(folder, arrays, numbers):
    # One array a run: each has a header of its own in the file.
    layout, columns = {}, {}
    for key, values in arrays.items():
        group, name = key.rsplit("/", 1)
        layout.setdefault(group, []).append([name, list(values.shape)])
        columns.setdefault(group, []).append(values.ravel())
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "signals.npz", **{group: np.concatenate(parts) for group, parts in columns.items()})
    (folder / "numbers.json").write_text(json.dumps({"layout": layout, "numbers": numbers}, indent=0) + "\n")


def flatten(key, value, arrays, numbers):
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in PASSING:
                flatten(f"{key}/{name}", inner, arrays, numbers)
    elif isinstance(value, np.ndarray):
        arrays[key] = value.astype(float)
    elif isinstance(value, (list, tuple)) and not all(isinstance(each, int | float | None) for each in value):
        for index, inner in enumerate(value):
            flatten(f"{key}/{index}", inner, arrays, numbers)
    else:
        numbers[key] = value


def recorded(folder):
    document = json.loads((folder / "numbers.json").read_text())
    found = document["numbers"]
    with np.load(folder / "signals.npz") as stored:
        for group, parts in document["layout"].items():
            ends = np.cumsum([math.prod(shape) for _, shape in parts])[:-1]
            for (name, shape), values in zip(parts, np.split(stored[group], ends), strict=True):
                found[f"{group}/{name}"] = values.reshape(shape)
    return found


def as_array(value):
    try:
        return np.atleast_1d(np.array(value, dtype=float))
    except (TypeError, ValueError):
        return np.array([math.nan])  # a text


def as_text(value):
    return repr(np.asarray(value).tolist())


def comparable(a, b):
    if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return False
    rest = ~np.isfinite(a)
    return not rest.all() and np.array_equal(a[rest], b[rest], equal_nan=True)


def distance(a, b):
    return np.abs(np.subtract(a, b, out=np.zeros(a.shape), where=np.isfinite(a)))


def usual(key, values):
    absolute, relative = next(pair for pattern, *pair in TOLERANCES if fnmatch.fnmatchcase(key, pattern))
    return absolute + relative * float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def difference(key, old, new, wider):
    a, b = as_array(old), as_array(new)
    if wider == math.inf or not comparable(a, b):
        same = wider == math.inf or as_text(old) == as_text(new)
        return [] if same else [(math.inf, key, f"{as_text(old):.80} -> {as_text(new):.80}")]
    tolerance = np.maximum(usual(key, a), np.reshape(wider, (-1, *[1] * (a.ndim - 1))))
    size = distance(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.where(size > 0.0, size / tolerance, 0.0)
    at = np.unravel_index(times.argmax(), times.shape)
    words = f"{size[at]:.2e} > {np.broadcast_to(tolerance, size.shape)[at]:.2e}"
    return [(float(times[at]), key, words)] if times[at] > 1.0 else []


def differences(before, after, wider):
    keys, none = before.keys() | after.keys(), "nothing"
    found = [difference(key, before.get(key, none), after.get(key, none), wider.get(key, 0.0)) for key in keys]
    return sorted(itertools.chain(*found), key=lambda each: (-each[0], each[1]))


def tolerances(folder):
    path = folder / "sensitive.json"
    return json.loads(path.read_text()) if path.exists() else {}


def compare(old, new):
    differ = differences(recorded(old), recorded(new), tolerances(old))
    for _, key, words in differ:
        print(f"{key}: {words}")
    return 1 if differ else 0


def check(*settings):
    failed = 0
    for setting in settings or ("native",):
        with tempfile.TemporaryDirectory() as folder:
            differs = compute_as(setting, folder) or compare(GOLDEN, Path(folder))
        print(f"golden set, {setting}: {'differs' if differs else 'agrees'}", flush=True)
        failed = failed or differs
    return failed


def main(what, *given):
    if what == "check":
        return check(*given)
    return {"record": record, "compute": compute, "compare": compare}[what](*map(Path, given))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
