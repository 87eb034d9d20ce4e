"""Tuners of settings as a system."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import Context, DiscreteValues, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import Demultiplexer

from stewart_drake.control.tuners import SettingTuner, chosen_settings
from stewart_drake.sampling import Sampled, on_grid

_SAID = (4, 1, 5)


class SettingSource(LeafSystem):
    """Settings of the loop from what is heard of it, see `control.policy`.

    What is found at a tick acts from the next one on: what is heard needs the torque, which needs the weights.

    Args:
        part: From `policy.setting_part`.
        period: [s] tick period.

    Ports:
        density: in (12,) [-].
        error: in (6,) [rad, m].
        torque: in (6,) [N m].
        innovation: in (6,) [rad].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        said: out (29,), see `constants.TUNER_MEMORY`: weights (4,), disturbance (1,) [rad/s^2 per sqrt(s)], setting
            (4,) [decades], outside (1,) [-], and what the next tick needs.
    """

    density: InputPort
    error: InputPort
    torque: InputPort
    innovation: InputPort
    reference: InputPort
    said: OutputPort

    def __init__(self, part: Sampled, period: float) -> None:
        super().__init__()
        first, self._tick = part
        sizes = {"density": 12, "error": 6, "torque": 6, "innovation": 6, "reference": 18}
        self._seen = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        for port in self._seen:
            setattr(self, port.get_name(), port)
        self.said = self.DeclareStateOutputPort("said", self.DeclareDiscreteState(first))
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=on_grid(period), offset_sec=0.0, update=self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        heard = [port.Eval(context) for port in self._seen]
        discrete_state.set_value(self._tick(*heard, context.get_discrete_state(0).value()))


def add_setting_tuner(wiring: Any, options: SettingTuner, density: OutputPort) -> OutputPort:
    """Adds a tuner of settings to a closed loop; its weights (4,)."""
    part = chosen_settings(options, wiring.scenario.tuner_site())
    heard = {name: wiring.signals[name] for name in ("error", "torque", "innovation")}
    tuner = SettingSource(part, wiring.period)
    added = wiring.add("tuner", tuner, density=density, reference=wiring.seen["reference"], **heard)
    rest = len(part.initial) - sum(_SAID)
    split = wiring.add("settings", Demultiplexer(output_ports_sizes=[*_SAID, rest]), u0=added.said)
    weights, wiring.level, wiring.signals["setting"] = (split.get_output_port(k) for k in range(len(_SAID)))
    return weights
