"""Tasks: what a folder in one of the formats of the field asks for."""
