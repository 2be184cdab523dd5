"""Models behind OpenAI-compatible servers, as agents and as judges: a plugin of GEM."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
