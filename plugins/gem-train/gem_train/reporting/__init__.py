"""What a training run leaves behind: ``metrics.jsonl``, TensorBoard and curves.

Names are imported on first use, so that a log is written without loading matplotlib.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
