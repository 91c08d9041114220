"""What can be chosen about the scene of a driving task."""

from typing import Literal, TypedDict

from palr_gym._proto.palr_gym.v1 import environment_pb2
from palr_gym.arguments import unsigned
from palr_gym.errors import InvalidArgument

_WEATHERS = {
    "fixed": environment_pb2.WEATHER_FIXED,
    "random": environment_pb2.WEATHER_RANDOM,
}


class SceneOptions(TypedDict, total=False):
    """What can be chosen about the scene of a driving task. What is left out keeps its default."""

    lead_car_probability: float
    """lane: with which probability an episode has a car ahead, in [0, 1]; 0.7."""
    vehicles: int
    """town: how many other vehicles drive about, 0 to 8; 4."""
    weather: Literal["fixed", "random"]
    """Light, fog and colours: always the same, or drawn at each reset; "fixed"."""


def scene_options_message(options: SceneOptions | None) -> environment_pb2.SceneOptions | None:
    """The message for `options`; None if there are none.

    Raises:
        InvalidArgument: They cannot be sent.
    """
    if options is None:
        return None
    known = SceneOptions.__annotations__
    for name in options:
        if name not in known:
            raise InvalidArgument(f"scene_options has {name!r}; expected some of {list(known)}")
    weather = options.get("weather", "fixed")
    if weather not in _WEATHERS:
        raise InvalidArgument(
            f"scene_options['weather'] is {weather!r}; expected one of {list(_WEATHERS)}"
        )
    vehicles = options.get("vehicles")
    return environment_pb2.SceneOptions(
        lead_car_probability=options.get("lead_car_probability"),
        vehicles=None if vehicles is None else unsigned("vehicles", vehicles, 32),
        weather=_WEATHERS[weather],
    )
