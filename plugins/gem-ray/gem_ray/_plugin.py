"""What this distribution offers; it imports no Ray."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import VectorBackendSpec, hookimpl


@hookimpl
def gem_register_vector_backends() -> Iterable[VectorBackendSpec]:
    """The backend ``ray``."""
    return [
        VectorBackendSpec(
            name="ray",
            entry_point="gem_ray.backend:actors",
            summary="Steps environments in actors of a Ray cluster, many in each.",
        )
    ]
