"""The problems of code:Sample with their solutions, right and wrong. Their tests are written by ``code_sample``."""
