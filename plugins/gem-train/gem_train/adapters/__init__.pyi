"""The public names, which are imported on first use."""

from .chat_session import ChatSession as ChatSession, ChatStep as ChatStep
from .chat_template import ChatTemplate as ChatTemplate
from .image_urls import images_as_urls as images_as_urls
from .token_agent import Generated as Generated, TokenAgent as TokenAgent
from .trial import TrialEngine as TrialEngine, trial_tokenizer as trial_tokenizer
