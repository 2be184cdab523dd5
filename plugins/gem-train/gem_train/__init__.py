"""Train agents: estimators, token batches, a small learner, and adapters to trainers; see ``docs/training.md``."""
