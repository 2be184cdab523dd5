"""The public names, which are imported on first use."""

from .adapters import ChatSession as ChatSession, TokenAgent as TokenAgent
from .learner.options import TrainOptions as TrainOptions
from .learner.run import train as train
from .tokens import TokenBatch as TokenBatch, batches as batches
