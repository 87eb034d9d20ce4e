"""Every kind of plant, motor, controller, tuner, sensor, reference, disturbance, monitor, fault, machine and recording.

A kind is one line here: the class of its section, which also makes its part of the loop, see `part.LoopContext`; of
faults an object. It is imported on first use: reading a scenario needs neither Drake nor kinds that it does not name.
`Family.add` and `Table.add` add kinds from outside of the package. Metrics are in `logs.metrics`.
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
        "stream": "safety.stream:StreamReference",
    },
    default="sine",
    user_section="references.recorded:UserReference",
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
    user_section="control.user_controller:PythonOptions",
    methods=("GetInputPort", "__call__"),
    former={
        "python": "the path of your class or function as the kind itself, such as path/to/file.py:Class",
        "decoupled_pid": "pid with inertia: robot, feedforward: motion, derivative: difference, sticking: 4 and "
        "dead_band: 2.5; kp, ki, kd for natural_frequency, integral_frequency, damping",
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
    user_section="hardware.sensors:UserSensors",
    methods=("parts",),
)
PLANTS = Family(
    {
        "drake": "plant.plant_options:DrakeOptions",
        "closed_form": "plant.closed_form:ClosedFormOptions",
        "mujoco": "plant.mujoco_plant:MujocoOptions",
    },
    default="drake",
    user_section="plant.plant_options:UserPlantOptions",
    methods=("step",),
)
MOTORS = Family(
    {
        "torque": "hardware.motors:TorqueMotors",
        "position": "hardware.servos:PositionServos",
        "current": "hardware.servos:CurrentMotors",
    },
    default="torque",
    user_section="hardware.motors:UserMotors",
    methods=("torque",),
)
ESTIMATORS = Family(
    {"difference": "control.estimator:DifferenceOptions", "observer": "control.observer:ObserverOptions"},
    default="difference",
    user_section="control.estimator:UserEstimator",
    methods=("parts",),
)
ADAPTATIONS = Family(
    {"regression": "control.adaptation:RegressionOptions"},
    default="regression",
    user_section="control.base:UserAdaptation",
    methods=("parts",),
)
OWN_MONITORS = Family({}, user_section="safety.options:UserMonitor", methods=("look",))
"""Users' monitors, under `safety.monitors`; the package's are in `safety.options`."""
OWN_METRICS = Family({}, user_section="logs.metrics:UserMetric", methods=("of",))
"""Users' metrics, under `metrics`; the package's are in `logs.metrics`."""
DISTURBANCES = Family(
    {
        "constant": "hardware.disturbances:ConstantWrench",
        "step": "hardware.disturbances:StepWrench",
        "impulse": "hardware.disturbances:ImpulseWrench",
        "sine": "hardware.disturbances:SineWrench",
        "noise": "hardware.disturbances:NoiseWrench",
    },
    user_section="hardware.disturbances:UserDisturbance",
    methods=("evaluate",),
)
MACHINES = Table({"reachy": "reachy.machine:ReachyMachine", "udp": "machines.udp:UdpMachine"})
"""Scheme of an address -> a class that is called with scenario, host and port; it may have a `default_port`."""
RECORDINGS = Table({".json": "reachy.moves:read_rows"})
"""Ending of a file with a recorded motion -> a function from its path to rows (n, 7) [s, rad, m]; tables need none."""

DANCES = Table({"reachy_mini": "reachy.commands:scenario_to_play"})
"""Robot -> a function of a scenario, a name or file of a move, and `force`, to the scenario that plays it."""


def _faults(*kinds: str, **others: str) -> Table:
    return Table({kind: f"hardware.faults:{others.get(kind, kind).upper()}" for kind in (*kinds, *others)})


ENCODER_FAULTS = _faults("freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped")
POSE_FAULTS = _faults("freeze", "nan", "late")
IMU_FAULTS = _faults("freeze", "nan", "jump", "drift", "late", "inverted")
COMMAND_FAULTS = _faults("nan", "inf", offset="jump", chatter="chatter")
MOTOR_FAULTS = _faults(reversed="inverted", swapped="swapped")

REGISTERED = [kinds for kinds in vars().copy().values() if isinstance(kinds, Table)]
"""All families and tables."""
