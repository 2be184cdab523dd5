"""Returns, advantages and losses for agents that act in turns: pure functions, the same for NumPy and torch.

A function returns the kind of array that it was given (NumPy or torch, its dtype, its device); losses and penalties of
16-bit floats are float32. Means and deviations are computed in float64. Shapes, throughout:

- ``E`` episodes, ``T`` turns of the longest of them; ``rewards``, ``values``, returns and advantages are float (E, T).
- ``mask``, bool (E, T): True where there is a turn. What stands elsewhere is ignored, NaN included; results are 0
  there.
- ``learnable``, bool (E, T) or (E,): what may be learnt from: no episode with an error, no idle turn. The rest is
  left out of means, deviations and baselines, and has the advantage 0.
- ``logprobs``, float (rows, L), and ``token_mask``, bool (rows, L): True on tokens that the model sampled.

All of them raise ``ValueError`` for a shape, a dtype or a factor that cannot be right. This package imports neither
torch nor gem_core.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
