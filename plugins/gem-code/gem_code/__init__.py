"""Programming problems, graded by tests in a sandbox: a plugin of GEM. ``CodeEnv`` asks the rows of any data set."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
