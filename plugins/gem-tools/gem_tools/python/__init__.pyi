"""The public names, which are imported on first use."""

from .errors import SandboxError as SandboxError
from .limits import Limits as Limits
from .outcome import Outcome as Outcome
from .pool import Pool as Pool, Session as Session, shared_pool as shared_pool
from .tool import PythonTool as PythonTool, make_python as make_python
