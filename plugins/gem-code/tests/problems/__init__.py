"""The problems of code:Sample with their solutions, right and wrong. What an agent may see is written by ``build``."""
