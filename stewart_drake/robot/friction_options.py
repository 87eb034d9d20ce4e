"""Friction of motors as numbers: what a robot has, or what a controller believes."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from stewart_drake.config import NotNegative, Section, as_problem, check_value
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot.leg import LARGEST, LEGS, Size

Moderate = Annotated[NotNegative, Field(le=LARGEST)]
SixNumbers = tuple[float, float, float, float, float, float]


class _Each:
    """In `Annotated`: one number in place of six stands for all motors."""

    def __init__(self, number: Any) -> None:
        self._number = number

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._six, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        six = handler(schema)
        return {"anyOf": [six["prefixItems"][0], six]}

    def _six(self, given: Any) -> Any:
        if not isinstance(given, (int, float)):
            return given
        try:
            check_value("", given, self._number)
        except ConfigurationError as error:
            raise as_problem(ConfigurationError("", given, f"{error.allowed}, or six of them")) from None
        return (given,) * LEGS


_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
EachMotor = Annotated[tuple[Moderate, Moderate, Moderate, Moderate, Moderate, Moderate], _Each(Moderate)]
EachRate = Annotated[tuple[Size, Size, Size, Size, Size, Size], _Each(Size)]


class FrictionOptions(Section, key="plant.friction"):
    """Friction of the motors that sticks, see `mechanics.friction`: for each key one number, or one for each motor."""

    coulomb: EachMotor = _NONE
    """[N m] dry friction in sliding."""
    break_away: EachMotor | None = None
    """[N m] what moves a motor that rests, at least `coulomb`; null: the same."""
    stribeck_velocity: EachRate = (0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
    """[rad/s] of sliding at which 37 % of what `break_away` is above `coulomb` are left; the default is our own."""
    viscous: EachMotor = _NONE
    """[N m s/rad] beside it, in proportion to speed."""

    def rules(self) -> None:
        """See `Section.rules`."""
        for above, below in zip(self.break_away or (), self.coulomb, strict=False):
            if above < below:
                raise ConfigurationError("break_away", above, f"at least `coulomb`, {below:g} N m")

    @property
    def levels(self) -> tuple[SixNumbers, SixNumbers, SixNumbers, SixNumbers]:
        """Coulomb [N m], break-away [N m], Stribeck rate [rad/s] and viscous [N m s/rad], six of each."""
        break_away = self.coulomb if self.break_away is None else self.break_away
        return self.coulomb, break_away, self.stribeck_velocity, self.viscous
