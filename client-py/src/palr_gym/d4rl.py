"""D4RL's HDF5 files."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray


def write_hdf5(
    path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, str]
) -> None:
    """Writes `arrays` and `texts` under their names; "/" in a name means a group.

    A file that exists is replaced in one moment; after an error it is as it was.

    Raises:
        ImportError: h5py is not installed.
        OSError: The file cannot be written.
    """
    try:
        import h5py
    except ImportError as error:
        raise ImportError(
            "saving a data set needs h5py, which is not installed: pip install palr-gym[hdf5]"
        ) from error

    path = Path(path)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    os.close(handle)
    temporary = Path(name)
    try:
        file: Any
        with h5py.File(temporary, "w") as file:
            for key, array in arrays.items():
                file.create_dataset(key, data=array, compression="gzip")
            for key, text in texts.items():
                file.create_dataset(key, data=text)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _umask() -> int:
    """The permissions that new files do not get; it can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
