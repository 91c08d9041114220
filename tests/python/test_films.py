"""Films that `palr-gym render` writes, read by FFmpeg."""

import subprocess
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from support.server_process import binary

STEPS = 30
WIDTH, HEIGHT = 97, 80


def render(out: Path, *arguments: str) -> None:
    """Renders the toy task; skips where there is no OpenGL."""
    line = [str(binary()), "render", "--env", "toy", "--seed", "3", "--out", str(out)]
    line += ["--size", f"{WIDTH}x{HEIGHT}", *arguments]
    finished = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    if "no OpenGL to draw with" in finished.stderr:
        pytest.skip(f"SKIPPED: {finished.stderr}")
    assert finished.returncode == 0, finished.stderr


def pictures(path: Path) -> list[NDArray[Any]]:
    """Every picture of a file, [height, width, 3], the padding left out."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    return [frame[:, :WIDTH].astype(int) for frame in frames]


def test_a_film_shows_every_step(tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    render(film, "--steps", str(STEPS))
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        # The task's own 20 steps a second; an odd side is made even.
        assert stream.average_rate == 20
        assert (stream.width, stream.height) == (WIDTH + 1, HEIGHT)
    frames = pictures(film)
    assert len(frames) == STEPS + 1
    for step in (0, 11, STEPS):
        picture = tmp_path / "picture.png"
        render(picture, "--step", str(step))
        [original] = pictures(picture)
        errors = [float(np.abs(frame - original).mean()) for frame in frames]
        assert errors[step] < 4.0
        # Where the cart moves, no other picture of the film is as near.
        assert min(errors) >= errors[step] - 0.5
    assert np.abs(frames[0] - frames[STEPS]).max() > 60
