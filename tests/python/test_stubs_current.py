"""The client's protobuf modules are what the .proto files say."""

import shutil
from pathlib import Path

import pytest

import generate_python_stubs as generator


def test_the_checked_in_stubs_are_current(capfd: pytest.CaptureFixture[str]) -> None:
    assert generator.main(["--check"]) == 0, capfd.readouterr().err


def test_stale_missing_and_superfluous_stubs_are_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stub_dir = tmp_path / "stubs"
    shutil.copytree(generator.STUB_DIR, stub_dir, ignore=shutil.ignore_patterns("__pycache__"))
    check = ["--check", "--stub-dir", str(stub_dir)]
    assert generator.main(check) == 0

    package = stub_dir / "palr_gym" / "v1"
    stale = package / "tensor_pb2.py"
    stale.write_text(stale.read_text() + "\n")
    missing = package / "policy_pb2.pyi"
    missing.unlink()
    superfluous = package / "forgotten_pb2.py"
    superfluous.touch()
    capfd.readouterr()
    assert generator.main(check) == 1
    named = capfd.readouterr().err
    assert [line.split(" ")[1] for line in named.splitlines() if line.startswith("stale:")] == [
        str(superfluous),
        str(missing),
        str(stale),
    ]

    assert generator.main(["--stub-dir", str(stub_dir)]) == 0
    assert generator.main(check) == 0
    assert not superfluous.exists()
