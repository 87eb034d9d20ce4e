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
            "hardware.sensor_faults:IdealSensors",
            "systems.task_space_sensor:add_ideal_sensor",
            "hardware.sensor_faults:IdealSensing",
        ),
        "encoders": (
            "hardware.estimator:EncoderOptions",
            "systems.motor_encoders:add_encoders",
            "hardware.estimator:EncoderSensing",
        ),
    }
)
ESTIMATORS = Family(
    {
        "difference": (
            "hardware.observer:DifferenceOptions",
            "systems.pose_estimator:add_difference",
            "hardware.estimator:DifferenceEstimating",
        ),
        "observer": (
            "hardware.observer:ObserverOptions",
            "systems.platform_observer:add_observer",
            "hardware.observing:ObserverEstimating",
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
        "reading_stuck": "safety.monitors:READING",
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
        "freeze": "hardware.sensor_faults:FREEZE",
        "nan": "hardware.sensor_faults:NAN",
        "jump": "hardware.sensor_faults:JUMP",
        "late": "hardware.sensor_faults:LATE",
        "drift": "hardware.sensor_faults:DRIFT",
        "reversed": "hardware.sensor_faults:REVERSED",
        "inverted": "hardware.sensor_faults:INVERTED",
        "swapped": "hardware.sensor_faults:SWAPPED",
    }
)
POSE_FAULTS = Table(
    {
        "freeze": "hardware.sensor_faults:FREEZE",
        "nan": "hardware.sensor_faults:NAN",
        "late": "hardware.sensor_faults:LATE",
    }
)
COMMAND_FAULTS = Table(
    {
        "nan": "hardware.command_link:NAN",
        "inf": "hardware.command_link:INF",
        "offset": "hardware.command_link:OFFSET",
        "chatter": "hardware.command_link:CHATTER",
    }
)
MOTOR_FAULTS = Table({"reversed": "hardware.motors:REVERSED", "swapped": "hardware.motors:SWAPPED"})

REGISTERED = [each for each in vars().copy().values() if isinstance(each, (Family, Table))]
"""All of them."""
