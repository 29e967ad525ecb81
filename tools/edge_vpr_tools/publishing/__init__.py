"""Matches of a live run for other programs: rows of JSON, over TCP and MQTT."""
