"""The public names, which are imported on first use."""

from .agent import OpenAIAgent as OpenAIAgent
from .judge import ModelJudge as ModelJudge
