"""A scene made ready: its mesh set up and distributed, what the plan leaves of it, and the state it begins from."""
