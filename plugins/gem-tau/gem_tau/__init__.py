"""Customer service with a simulated user: a plugin of GEM, for the tasks of tau-bench and tau2-bench."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
