"""Pictures of remote environments."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from palr_gym._proto.palr_gym.v1 import render_service_pb2
from palr_gym.arguments import unsigned
from palr_gym.connection import RENDER, Connection
from palr_gym.errors import InvalidArgument
from palr_gym.tensors import UINT8, to_array

RENDER_MODES = ("rgb_array",)


@dataclass(frozen=True)
class Picture:
    """What `render` draws."""

    camera: str = ""
    """One of `EnvironmentSpec.camera_names`; empty: the first of them."""
    width_px: int = 480
    height_px: int = 480

    @staticmethod
    def of(camera: str, size: "tuple[SupportsIndex, SupportsIndex]") -> "Picture":
        """From arguments, checked as far as a message needs it.

        Raises:
            InvalidArgument: A side is no number that can be sent.
        """
        width_px, height_px = size
        return Picture(
            camera, unsigned("render_size", width_px, 32), unsigned("render_size", height_px, 32)
        )


def checked_render_mode(render_mode: str | None) -> str | None:
    """`render_mode` if it is one.

    Raises:
        InvalidArgument: It is none.
    """
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise InvalidArgument(f"render_mode is {render_mode!r}; expected None or 'rgb_array'")
    return render_mode


def render(
    connection: Connection,
    session_id: str,
    picture: Picture,
    env_indices: Sequence[int] = (),
) -> NDArray[np.uint8]:
    """Draws environments of a session as they stand.

    Args:
        connection: To the server.
        session_id: The session.
        picture: What to draw.
        env_indices: Which environments, ascending; empty: all.

    Returns:
        [environments, height, width, 3].

    Raises:
        PalrGymError: The kind that fits; `FailedPrecondition` if the server cannot draw.
    """
    request = render_request(session_id, picture, env_indices)
    return pictures(
        connection.unary(RENDER, request, asked=f"drawing session {session_id}"), picture
    )


def render_request(
    session_id: str, picture: Picture, env_indices: Sequence[int]
) -> render_service_pb2.RenderRequest:
    """The message that asks for pictures."""
    return render_service_pb2.RenderRequest(
        session_id=session_id,
        env_indices=[unsigned("environment index", index, 32) for index in env_indices],
        camera=picture.camera,
        width_px=picture.width_px,
        height_px=picture.height_px,
        format=render_service_pb2.IMAGE_FORMAT_RAW_RGB,
    )


def pictures(response: render_service_pb2.RenderResponse, picture: Picture) -> NDArray[np.uint8]:
    """[environments, height, width, 3] of an answer.

    Raises:
        ServerError: Not what was promised.
    """
    frames: NDArray[Any] = to_array(
        response.rgb, UINT8, (-1, picture.height_px, picture.width_px, 3)
    )
    return frames
