"""The public names, which are imported on first use."""

from .remote import (
    NoRoomError as NoRoomError,
    RemoteEnv as RemoteEnv,
    Worker as Worker,
    WorkerDiedError as WorkerDiedError,
    WorkerPool as WorkerPool,
)
from .setup import VectorSetup as VectorSetup
from .vector_env import VectorEnv as VectorEnv
from .worker import WorkerLoop as WorkerLoop
