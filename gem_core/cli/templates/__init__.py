"""What ``gem new-plugin`` writes: files with words such as ``@package@``, which are replaced."""
