"""Do the discount factor and Return Batch Normalization help? The experiment is ``gem_train/gamma_study.py``.

    python examples/paper/gamma.py --quick

This is ``gem train-study gamma``, and takes the same options.
"""

import sys

from gem_train.gamma_study import command

if __name__ == "__main__":
    command(["gamma", *sys.argv[1:]])
