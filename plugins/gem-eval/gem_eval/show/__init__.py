"""``gem show``: a list of episodes, one of them turn by turn, or a page for the browser."""
