"""The environments' ids in Gymnasium's registry, and makers for all other combinations."""

from typing import Any, SupportsIndex

import gymnasium

from palr_gym.env import RemoteEnv
from palr_gym.vector import RemoteVectorEnv

TASKS = ("hopper", "walker2d", "halfcheetah", "ant", "toy")
GYM5_TASKS = ("hopper", "walker2d", "halfcheetah", "ant")
DEEPEST_REGISTERED_STACK = 5


def registered_env_ids() -> list[str]:
    """The server's ids of the environments that are registered.

    Full, paper's and strict mask, and each of Gymnasium's tasks as Gymnasium's `-v5` defines it;
    of `lane` its state, features of what the driver sees, and pictures of it; of `town` its state.
    """
    stacks = range(1, DEEPEST_REGISTERED_STACK + 1)
    robots = [
        env_id
        for task in TASKS
        for env_id in (
            task,
            *((f"{task}-gym5",) if task in GYM5_TASKS else ()),
            *(f"{task}-w{frame_stack}" for frame_stack in stacks),
            *(f"{task}-strict-w{frame_stack}" for frame_stack in stacks),
        )
    ]
    lanes = [f"lane{kind}-w{frame_stack}" for kind in ("", "-pixels") for frame_stack in stacks]
    return [*robots, "lane", *lanes, "town"]


def register_envs() -> None:
    """Registers `palr_gym/<id>-v0`. Needs no server. Repeating it changes nothing."""
    for env_id in registered_env_ids():
        gymnasium_id = f"palr_gym/{env_id}-v0"
        if gymnasium_id not in gymnasium.registry:
            gymnasium.register(  # pyright: ignore[reportUnknownMemberType] - its bare dict
                id=gymnasium_id,
                entry_point="palr_gym.env:RemoteEnv",
                vector_entry_point="palr_gym.vector:RemoteVectorEnv",
                kwargs={"env_id": env_id},
            )


def make(env_id: str, **kwargs: Any) -> RemoteEnv:
    """Any environment of a server, without Gymnasium's wrappers.

    Args:
        env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0], such as "ant-full-w8".
        **kwargs: As `RemoteEnv` takes them.
    """
    return RemoteEnv(env_id, **kwargs)


def make_vec(env_id: str, num_envs: SupportsIndex = 1, **kwargs: Any) -> RemoteVectorEnv:
    """Any environment of a server, N times.

    Args:
        env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0], such as "ant-full-w8".
        num_envs: N.
        **kwargs: As `RemoteVectorEnv` takes them.
    """
    return RemoteVectorEnv(env_id, num_envs, **kwargs)
