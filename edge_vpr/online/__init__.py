"""Online matching: a match after every event, from exactly updated counters and distances."""
