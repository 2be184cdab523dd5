"""The public names, which are imported on first use."""

from .grading import Grade as Grade, grade as grade
from .math_env import MathEnv as MathEnv
