"""Every kind of plant, motor, controller, tuner, sensor, reference, disturbance, monitor, fault, machine and recording.

A kind is one line here: its section, which also makes its part of the loop, see `part.LoopContext`; for faults one
object. Names are texts, imported when a kind is asked for: to read a scenario takes neither Drake nor what the scenario
does not name. `Family.add` and `Table.add` take a kind from outside of the package. Metrics stand in `logs.metrics`.
"""

from stewart_drake.base.families import Family, Table

REFERENCES = Family(
    {
        "hold": "references.motions:HoldReference",
        "sine": "references.motions:SineReference",
        "sine_bursts": "references.motions:SineBurstsReference",
        "breathing": "references.surgical:BreathingReference",
        "heartbeat": "references.surgical:HeartbeatReference",
        "tremor": "references.surgical:TremorReference",
        "minimum_jerk": "references.motions:MinimumJerkReference",
        "spline": "references.motions:SplineReference",
        "recorded": "references.recorded:RecordedReference",
        "sum": "references.motions:SumReference",
        "adjusted": "references.motions:AdjustedReference",
    },
    default="sine",
    own="references.recorded:UserReference",
    methods=("evaluate", "__call__"),
)
CONTROLLERS = Family(
    {
        "lqi": "control.lqi:LqiOptions",
        "pid": "control.classical:PidOptions",
        "computed_torque": "control.classical:ComputedTorqueOptions",
        "feedforward": "control.feedforward:FeedforwardOptions",
    },
    default="lqi",
    own="control.user_controller:PythonOptions",
    methods=("GetInputPort", "__call__"),
    gone={
        "decoupled_pid": "pid with inertia: robot, feedforward: motion, derivative: difference, sticking: 4 and "
        "dead_band: 2.5; kp, ki, kd for natural_frequency, integral_frequency, damping"
    },
)
TUNERS = Family(
    {
        "fixed": "control.tuners:FixedTuner",
        "paper": "control.tuners:PaperTuner",
        "block": "control.tuners:BlockTuner",
        "policy": "control.tuners:PolicyTuner",
        "schedule": "control.tuners:ScheduleTuner",
    },
    default="paper",
)
SENSORS = Family(
    {"ideal": "hardware.sensors:IdealSensors", "encoders": "hardware.sensors:EncoderOptions"},
    default="ideal",
    own="hardware.sensors:UserSensors",
    methods=("parts",),
)
PLANTS = Family(
    {
        "drake": "plant.plant_options:DrakeOptions",
        "closed_form": "plant.closed_form:ClosedFormOptions",
        "mujoco": "plant.mujoco_plant:MujocoOptions",
    },
    default="drake",
    own="plant.plant_options:UserPlantOptions",
    methods=("step",),
)
MOTORS = Family(
    {
        "torque": "hardware.motors:TorqueMotors",
        "position": "hardware.servos:PositionServos",
        "current": "hardware.servos:CurrentMotors",
    },
    default="torque",
    own="hardware.motors:UserMotors",
    methods=("torque",),
)
ESTIMATORS = Family(
    {"difference": "control.estimator:DifferenceOptions", "observer": "control.observer:ObserverOptions"},
    default="difference",
    own="control.estimator:UserEstimator",
    methods=("parts",),
)
ADAPTATIONS = Family(
    {"regression": "control.adaptation:RegressionOptions"},
    default="regression",
    own="control.base:UserAdaptation",
    methods=("parts",),
)
OWN_MONITORS = Family({}, own="safety.options:UserMonitor", methods=("look",))
"""Monitors of the user, under `safety.monitors`; the others are in `safety.options`."""
OWN_METRICS = Family({}, own="logs.metrics:UserMetric", methods=("of",))
"""Those of the user's own, under `metrics`; the others stand in `logs.metrics`."""
DISTURBANCES = Family(
    {
        "constant": "hardware.disturbances:ConstantWrench",
        "step": "hardware.disturbances:StepWrench",
        "impulse": "hardware.disturbances:ImpulseWrench",
        "sine": "hardware.disturbances:SineWrench",
        "noise": "hardware.disturbances:NoiseWrench",
    },
    own="hardware.disturbances:UserDisturbance",
    methods=("evaluate",),
)
MACHINES = Table({"reachy": "reachy.machine:ReachyMachine", "udp": "machines.udp:UdpMachine"})
"""By the scheme of an address: a class that is made of scenario, host and port; `default_port` where it has one."""
RECORDINGS = Table({".json": "reachy.moves:read_rows"})
"""Of recorded motions by the ending of a file, besides tables: a function from a path to rows (n, 7) [s, rad, m]."""


def _faults(*kinds: str, **others: str) -> Table:
    return Table({kind: f"hardware.faults:{others.get(kind, kind).upper()}" for kind in (*kinds, *others)})


ENCODER_FAULTS = _faults("freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped")
POSE_FAULTS = _faults("freeze", "nan", "late")
COMMAND_FAULTS = _faults("nan", "inf", offset="jump", chatter="chatter")
MOTOR_FAULTS = _faults(reversed="inverted", swapped="swapped")

REGISTERED = [each for each in vars().copy().values() if isinstance(each, (Family, Table))]
"""All of them."""
