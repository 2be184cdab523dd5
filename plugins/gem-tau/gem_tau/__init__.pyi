"""The public names, which are imported on first use."""

from .database import Database as Database, fork as fork
from .domains import Domain as Domain
from .env import TauEnv as TauEnv
from .folders import TaskSet as TaskSet, read_folder as read_folder
from .heatmap import heat_map as heat_map
from .rewards import Reward as Reward, replay as replay, reward as reward
from .tasks import Action as Action, Task as Task
