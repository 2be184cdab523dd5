"""Vector environments: many environments that are reset and stepped together."""
