"""A match after every event: the state of the newest windows, kept exact as events come and go."""
