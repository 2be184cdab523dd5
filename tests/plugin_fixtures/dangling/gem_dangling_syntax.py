"""Is not finished."""

class MathEnv(
