"""Every kind of controller, tuner, sensor, reference, disturbance, monitor and fault, and where it is implemented.

A kind is one line here: its section, the LeafSystem that runs it, and what runs it outside of a Diagram (`plant.engine:
reduced`); for faults and monitors one object. Names are texts, imported when a kind is asked for: to read a scenario
takes neither Drake nor what the scenario does not name. `Family.add` and `Table.add` take a kind from outside of the
package. Metrics stand in `logs.metric_table`.
"""

from stewart_drake.families import Family, Table

REFERENCES = Family(
    {
        "hold": ("references.basic:HoldReference",),
        "sine": ("references.basic:SineReference",),
        "sine_bursts": ("references.basic:SineBurstsReference",),
        "breathing": ("references.surgical:BreathingReference",),
        "heartbeat": ("references.surgical:HeartbeatReference",),
        "tremor": ("references.surgical:TremorReference",),
        "minimum_jerk": ("references.paths:MinimumJerkReference",),
        "spline": ("references.paths:SplineReference",),
        "recorded": ("references.recorded:RecordedReference",),
        "sum": ("references.combined:SumReference",),
        "adjusted": ("references.combined:AdjustedReference",),
    },
    own="references.user_reference:UserReference",
    method="evaluate",
)
CONTROLLERS = Family(
    {
        "lqi": (
            "control.lqi_options:LqiOptions",
            "systems.lqi_controller:LqiController.build",
            "control.lqi:lqi_part",
        ),
        "pid": ("control.joint_pid:PidOptions", "systems.joint_pid:JointPid.build", "control.joint_pid:pid_part"),
        "computed_torque": (
            "control.computed_torque:ComputedTorqueOptions",
            "systems.computed_torque:ComputedTorque.build",
            "control.computed_torque:computed_torque_part",
        ),
        "python": ("control.user_controller:PythonOptions", "systems.user_controller:load_user_controller"),
    },
    default="lqi",
    own="control.user_controller:PythonOptions",
    method="GetInputPort",
)
TUNERS = Family(
    {
        "fixed": ("control.tuners:FixedTuner", "systems.ann_tuner:add_fixed_weights", "control.tuners:held_weights"),
        "paper": ("control.tuners:AnnTuner", "systems.ann_tuner:add_network_tuner", "control.tuners:asked_weights"),
        "block": ("control.tuners:BlockTuner", "systems.ann_tuner:add_fixed_weights", "control.tuners:held_weights"),
        "policy": (
            "control.tuners:PolicyTuner",
            "systems.setting_tuner:add_setting_tuner",
            "control.tuners:chosen_settings",
        ),
        "schedule": (
            "control.tuners:ScheduleTuner",
            "systems.setting_tuner:add_setting_tuner",
            "control.tuners:chosen_settings",
        ),
    },
    older={"ann": "paper"},
)
SENSORS = Family(
    {
        "ideal": (
            "hardware.sensors:IdealSensors",
            "systems.task_space_sensor:add_ideal_sensor",
        ),
        "encoders": (
            "hardware.sensors:EncoderOptions",
            "systems.motor_encoders:add_encoders",
        ),
    }
)
ESTIMATORS = Family(
    {
        "difference": (
            "hardware.estimator:DifferenceOptions",
            "systems.pose_estimator:add_difference",
        ),
        "observer": (
            "hardware.observer:ObserverOptions",
            "systems.platform_observer:add_observer",
        ),
    },
    default="difference",
)
OWN_MONITORS = Family({}, own="safety.user_monitor:UserMonitor", method="look")
"""Those of the user's own, under `safety.monitors`."""
BUILT_IN_MONITORS = Table(
    {
        "measurement_not_finite": "safety.monitors:MEASUREMENT",
        "sensor_failed": "safety.monitors:SENSOR",
        "controller_failed": "safety.monitors:CONTROLLER",
        "command_not_finite": "safety.monitors:COMMAND",
        "deadline": "safety.monitors:DEADLINE",
        "workspace": "safety.monitors:WORKSPACE",
        "serial_singularity": "safety.monitors:SERIAL",
        "parallel_singularity": "safety.monitors:PARALLEL",
        "crank_speed": "safety.monitors:CRANK_SPEED",
        "following_error": "safety.monitors:FOLLOWING",
        "torque_limit": "safety.monitors:TORQUE_LIMIT",
        "torque_rate": "safety.monitors:TORQUE_RATE",
        "innovation": "safety.monitors:INNOVATION",
    }
)
"""Their limits are keys of `safety`; the place here, from 1, is the number in a log: new ones come last."""
OWN_METRICS = Family({}, own="logs.user_metric:UserMetric", method="of")
"""Those of the user's own, under `metrics`; the others stand in `logs.metric_table`."""
DISTURBANCES = Family(
    {
        "constant": ("hardware.disturbances:ConstantWrench",),
        "step": ("hardware.disturbances:StepWrench",),
        "impulse": ("hardware.disturbances:ImpulseWrench",),
        "sine": ("hardware.disturbances:SineWrench",),
        "noise": ("hardware.disturbances:NoiseWrench",),
    },
    own="hardware.disturbances:UserDisturbance",
    method="evaluate",
)
ENCODER_FAULTS = Table(
    {
        "freeze": "hardware.faults:FREEZE",
        "nan": "hardware.faults:NAN",
        "jump": "hardware.faults:JUMP",
        "late": "hardware.faults:LATE",
        "drift": "hardware.faults:DRIFT",
        "reversed": "hardware.faults:REVERSED",
        "inverted": "hardware.faults:INVERTED",
        "swapped": "hardware.faults:SWAPPED",
    }
)
POSE_FAULTS = Table(
    {
        "freeze": "hardware.faults:FREEZE",
        "nan": "hardware.faults:NAN",
        "late": "hardware.faults:LATE",
    }
)
COMMAND_FAULTS = Table(
    {
        "nan": "hardware.faults:NAN",
        "inf": "hardware.faults:INF",
        "offset": "hardware.faults:JUMP",
        "chatter": "hardware.faults:CHATTER",
    }
)
MOTOR_FAULTS = Table({"reversed": "hardware.faults:INVERTED", "swapped": "hardware.faults:SWAPPED"})

REGISTERED = [each for each in vars().copy().values() if isinstance(each, (Family, Table))]
"""All of them."""
