"""Workers: processes, or actors of a plugin, in which environments live and can be killed and replaced."""
