"""Takes the shared libraries that the Rust build links or loads out of Python wheels.

Usage: unpack_native.py FOLDER WHEEL...
"""

import sys
import zipfile
from pathlib import Path

WANTED = ("libmujoco.so.", "libonnxruntime.so.")


def main() -> None:
    """Copies each wanted library to FOLDER and adds the bare `.so` name that a linker asks for."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for wheel in sys.argv[2:]:
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.namelist():
                name = Path(member).name
                if not name.startswith(WANTED):
                    continue
                # Written beside and renamed, so that an interrupted set-up leaves no torn library.
                partial = folder / (name + ".partial")
                partial.write_bytes(archive.read(member))
                partial.replace(folder / name)
                link = folder / (name.split(".so.")[0] + ".so")
                link.unlink(missing_ok=True)
                link.symlink_to(name)


if __name__ == "__main__":
    main()
