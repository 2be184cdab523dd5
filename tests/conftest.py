"""Registers the toy environments for every test of the core."""

from __future__ import annotations

import toys

toys.register_toys()
