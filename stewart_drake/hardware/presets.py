"""Commercial motors: the numbers of `motors: {kind: position | current, preset: NAME}`, with their sources.

A preset sets the defaults of the other keys, and of the gear's friction in `plant` and `model`. Unpublished constants
are estimates, and marked as such.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.families import Table


class Preset(NamedTuple):
    """A motor: keys for the kinds `position` and `current`, friction of its gear, and how it is commanded."""

    about: str
    coulomb: float = 0.0  # [N m].
    viscous: float = 0.0  # [N m s/rad].
    position: Mapping[str, object] | None = None
    current: Mapping[str, object] | None = None
    wiring: Wire | None = None


class Wire(NamedTuple):
    """What a servo is sent, see `ServoOptions`. Six bus servos at 1,000,000 baud take 100 commands a second."""

    kind: Literal["rc", "sts", "dynamixel"]  # Pulses, or whose bus.
    commands: tuple[float, float] = (0.0, 4095.0)  # Pulses [us], or counts of a bus servo.
    travel: float = 2.0 * math.pi * 4095.0 / 4096.0  # [rad] from one to the other.
    rate: float = 100.0  # [1/s] most commands.


def _rc(about: str, torque: float, seconds: float, dead_band: float, backlash: float, rate: float) -> Preset:
    """An RC servo of a stall torque [N m] and a time [s] for 60 deg, with a dead band [us]; 180 deg for 2000 us.

    Full torque at an error of 4 deg, friction of 3 % of it, and play [deg] are estimates for all of them.
    """
    speed = math.radians(60.0) / seconds
    numbers = {"stiffness": torque / math.radians(4.0), "damping": torque / speed, "torque_limit": torque}
    numbers |= {"no_load_speed": speed, "backlash": math.radians(backlash), "dead_band": dead_band * math.pi / 2000.0}
    wire = Wire("rc", (500.0, 2500.0), math.pi, rate)
    return Preset(about, coulomb=0.03 * torque, position={**numbers, "resolution_bits": None}, wiring=wire)


PRESETS = {
    # 0.52 N m at 1.47 A, 103 rev/min, 12 bits, current in steps of 1 mA: ROBOTIS e-Manual, XL330-M288-T at 5 V. Reachy
    # Mini's servos are set to a gain P of 300. Stiffness and damping at it, and friction: by the constants that
    # github.com/Rhoban/bam identified, whose models give 0.6 to 1.7 N m/rad and 0.037 to 0.048 N m s/rad.
    "xl330_m288": Preset(
        "Dynamixel XL330-M288 at 5 V: 0.52 N m, 618 deg/s",
        coulomb=0.0128,
        viscous=0.0037,
        position={"stiffness": 1.0, "damping": 0.04, "torque_limit": 0.52, "no_load_speed": math.radians(618.0)},
        current={"torque_constant": 0.52 / 1.47, "current_limit": 1.47, "resolution": 0.001}
        | {"no_load_speed": math.radians(618.0)},
        wiring=Wire("dynamixel"),
    ),
    # 30 kg cm and 45 rev/min at 12 V, 12 bits: Feetech's data sheet of the STS3215-C018 (gear 1:345). Stiffness,
    # damping and friction: class sts3215_345 of the MJCF in reachy_mini 1.13.0, which reports good simulations of a
    # walking robot with it. That robot, Open Duck Mini, has the servo at 7.4 V, and a servo's stiffness is proportional
    # to its supply: 17.11 N m/rad become 27.7 at 12 V. Owners at robonine.com measured 1.8 to 2.6 deg under 1.5 kg on
    # 10 cm at 45 deg, 23 to 33 N m/rad. Play is 0.87 deg, measured with an indicator; about 1 deg by hand (issue 134 of
    # TheRobotStudio/SO-ARM100), at most 0.5 deg in the data sheet.
    "sts3215": Preset(
        "Feetech STS3215, gear 1:345, at 12 V: 2.94 N m, 270 deg/s",
        coulomb=0.068,
        position={"stiffness": 27.7, "damping": 0.56, "torque_limit": 2.94, "no_load_speed": math.radians(270.0)}
        | {"backlash": math.radians(0.87)},
        wiring=Wire("sts"),
    ),
    # 20 kg cm and 0.16 s for 60 deg at 6.8 V, dead band 3 us of 2000 us for 180 deg: data sheets of 20 kg cm servos
    # such as the DS3218. Full torque at an error of 4 deg, friction of 3 % of it and half a degree of play: estimates.
    "rc_20kg": Preset(
        "RC servo of 20 kg cm at 6.8 V: 1.96 N m, 375 deg/s",
        coulomb=0.06,
        position={"stiffness": 28.0, "damping": 0.3, "torque_limit": 1.96, "no_load_speed": math.radians(375.0)}
        | {"resolution_bits": None, "dead_band": math.radians(0.27), "backlash": math.radians(0.5)},
        wiring=Wire("rc", (500.0, 2500.0), math.pi, 50.0),
    ),
    # 11 kg cm, 0.14 s for 60 deg at 6 V, dead band 5 us, 50 Hz: TowerPro's data sheet of the MG996R, "High Torque Metal
    # Gear Dual Ball Bearing Servo". It gives 120 deg for 1 to 2 ms; shops sell it as 180 deg for 500 to 2500 us, and a
    # copy was measured at 600 to 2300 us. Measure yours.
    "mg996r": _rc("TowerPro MG996R at 6 V: 1.08 N m, 429 deg/s", 1.08, 0.14, dead_band=5.0, backlash=1.0, rate=50.0),
    # 21.5 kg cm, 0.14 s for 60 deg at 6.8 V, dead band 3 us, 333 Hz: DSServo's data sheet of the DS3218. There is one
    # of 180 deg and one of 270 deg; for the latter write `travel: 270 deg`.
    "ds3218": _rc("DSServo DS3218 at 6.8 V: 2.11 N m, 429 deg/s", 2.11, 0.14, dead_band=3.0, backlash=0.5, rate=333.0),
    # 2.2 kg cm, 0.08 s for 60 deg at 6 V, dead band 5 us, 50 Hz: TowerPro's data sheet of the MG90S. The SG90, of
    # plastic gears, has 1.8 kg cm and 0.1 s at 4.8 V, and is sold as 180 deg for 500 to 2400 us.
    "mg90s": _rc("TowerPro MG90S at 6 V: 0.216 N m, 750 deg/s", 0.216, 0.08, dead_band=5.0, backlash=1.0, rate=50.0),
    # Classes of the MJCF in reachy_mini 1.13.0 (Pollen Robotics): the one that its simulation uses, and the one of the
    # real motor, with the remark "probably wrong, would need to re-identify".
    "perfect_actuator": Preset(
        "the actuator of Reachy Mini's simulation",
        coulomb=0.1,
        viscous=0.15,
        position={"stiffness": 10.0, "damping": 0.1, "torque_limit": 20.0, "resolution_bits": None},
    ),
    "xc330m288t": Preset(
        "the servo of Reachy Mini as its maker's MJCF has it",
        coulomb=0.058,
        viscous=0.095,
        position={"stiffness": 2.54, "damping": 0.0, "torque_limit": 0.8},
    ),
}


class Presets(Table):
    """The presets of a kind of motor; in `Annotated` the type of a key that names one."""

    def __init__(self, kind: str) -> None:
        super().__init__({name: getattr(preset, kind) for name, preset in PRESETS.items() if getattr(preset, kind)})

    def with_defaults(self, given: Mapping[str, object]) -> Document:
        """The keys, with the defaults of their preset."""
        preset = given.get("preset")
        return {**(self[preset] if preset in self.names else {}), **given}
