"""The public names, which are imported on first use."""

from .env import PostgresEnv as PostgresEnv
from .errors import PostgresError as PostgresError, TaskError as TaskError
from .tasks import Task as Task, read_tasks as read_tasks
