"""``gem show``: a list of episodes, one of them turn by turn, two compared, or a page for the browser."""
