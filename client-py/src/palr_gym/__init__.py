"""Gymnasium client for palr-gym, a server of partially observed MuJoCo environments.

- `gymnasium.make("palr_gym/hopper-w2-v0", server="localhost:7257")`: one environment.
- `gymnasium.make_vec("palr_gym/hopper-w2-v0", num_envs=64, server=...)`: many, in one session.
- `evaluate("hopper-w2", "policy.onnx")`, `collect("hopper", "expert", transitions=30_000)`: the
  server steps the environments itself.
- `load_dataset("hopper.hdf5")`: recorded demonstrations as arrays, or for torch.
- `hscic(representation, past_action, given_action)`: how much the first repeats the second.
- `Client`: everything else that a server offers; `palr_gym.aio.Client` for asyncio.

Importing this package registers the environments with Gymnasium. It opens no connection.
"""

from palr_gym._version import __version__
from palr_gym.client import DEFAULT_SERVER, SERVER_VARIABLE, Client
from palr_gym.collection import Dataset, collect
from palr_gym.env import OpenLoop, RemoteEnv
from palr_gym.errors import (
    Cancelled,
    DeadlineExceeded,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    PalrGymError,
    ResetNeeded,
    ResourceExhausted,
    ServerError,
    ServerUnavailable,
    Unimplemented,
)
from palr_gym.evaluation import EpisodeResult, Evaluation, evaluate
from palr_gym.leakage import Hscic, hscic
from palr_gym.recordings import Recording, load_dataset
from palr_gym.registration import make, make_vec, register_envs
from palr_gym.results import DivergedEpisode, ResetResult, RestoredState, StepResult
from palr_gym.scene_options import SceneOptions
from palr_gym.session import Session
from palr_gym.specs import (
    EnvironmentSpec,
    Expert,
    FeatureExtractor,
    FidelityProfile,
    OpenGl,
    ReferenceReturns,
    ServerInfo,
    ServerLimits,
    Task,
)
from palr_gym.vector import RemoteVectorEnv, VectorOpenLoop

__all__ = [
    "DEFAULT_SERVER",
    "SERVER_VARIABLE",
    "Cancelled",
    "Client",
    "Dataset",
    "DeadlineExceeded",
    "DivergedEpisode",
    "EnvironmentSpec",
    "EpisodeResult",
    "Evaluation",
    "Expert",
    "FailedPrecondition",
    "FeatureExtractor",
    "FidelityProfile",
    "Hscic",
    "InvalidArgument",
    "NotFound",
    "OpenGl",
    "OpenLoop",
    "PalrGymError",
    "Recording",
    "ReferenceReturns",
    "RemoteEnv",
    "RemoteVectorEnv",
    "ResetNeeded",
    "ResetResult",
    "ResourceExhausted",
    "RestoredState",
    "SceneOptions",
    "ServerError",
    "ServerInfo",
    "ServerLimits",
    "ServerUnavailable",
    "Session",
    "StepResult",
    "Task",
    "Unimplemented",
    "VectorOpenLoop",
    "__version__",
    "collect",
    "evaluate",
    "hscic",
    "load_dataset",
    "make",
    "make_vec",
    "register_envs",
]

register_envs()
