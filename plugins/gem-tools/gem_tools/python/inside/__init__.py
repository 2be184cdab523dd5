"""What runs inside a sandbox. Standard library only: these modules are sent there as text, see ``levels.bootstrap``."""
