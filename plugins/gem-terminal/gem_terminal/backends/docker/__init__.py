"""Machines from a container engine: Docker, or Podman's socket of the same kind."""
