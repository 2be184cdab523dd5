"""The tasks of terminal:Sample, each written once; ``build.py`` makes both formats of them."""
