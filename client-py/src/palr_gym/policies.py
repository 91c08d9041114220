"""Policies that a server runs itself."""

import os
from pathlib import Path

from palr_gym._proto.palr_gym.v1 import policy_pb2
from palr_gym.errors import InvalidArgument

PolicySource = str | os.PathLike[str] | bytes
"""`"random"`, `"expert"`, the path of an ONNX file, or the bytes of one."""


def policy_message(policy: PolicySource) -> policy_pb2.Policy:
    """The policy as the server takes it.

    Raises:
        InvalidArgument: There is no such policy or file.
    """
    if isinstance(policy, bytes):
        return policy_pb2.Policy(onnx=policy)
    if policy == "random":
        return policy_pb2.Policy(random=policy_pb2.RandomPolicy())
    if policy == "expert":
        return policy_pb2.Policy(expert=policy_pb2.ExpertPolicy())
    try:
        return policy_pb2.Policy(onnx=Path(policy).read_bytes())
    except OSError as error:
        raise InvalidArgument(
            f"policy {os.fspath(policy)!r} cannot be read ({error.strerror}); expected 'random', "
            "'expert', the path of an ONNX file, or the bytes of one"
        ) from error


def policy_name(policy: PolicySource) -> str:
    """The policy for people: its name or path, or "onnx"."""
    return "onnx" if isinstance(policy, bytes) else os.fspath(policy)


def action_mode(*, sampled: bool) -> policy_pb2.ActionMode:
    """How actions are taken from a policy."""
    if sampled:
        return policy_pb2.ACTION_MODE_SAMPLED
    return policy_pb2.ACTION_MODE_DETERMINISTIC
