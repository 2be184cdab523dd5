"""Templates of ``gem new-plugin``: files with placeholders such as ``@package@``."""
