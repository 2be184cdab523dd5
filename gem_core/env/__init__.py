"""What an environment is: ``Env``, ``Wrapper``, the guard around a task, spaces of text, and seeding."""
