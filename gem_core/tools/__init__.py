"""Tools: what one is, how calls are read out of a response, and the wrapper that gives tools to a task."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
