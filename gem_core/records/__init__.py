"""What is kept of episodes: transitions, the conversation, files, plans, and scores."""
