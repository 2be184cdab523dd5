"""Vector environments, which run many environments at once, and the classes to build a backend from.

A backend is a function of a ``VectorSetup`` that returns a ``VectorEnv``. Where environments live in workers that can
be killed, it gives the vector environment a ``WorkerPool``, whose ``start`` returns a ``Worker``: something that passes
a request to a ``WorkerLoop`` in another process, and returns the reply. The plugin gem-ray is an example.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
