"""Score models on environments, and read, compare and trust the result; see ``docs/evaluation.md``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
