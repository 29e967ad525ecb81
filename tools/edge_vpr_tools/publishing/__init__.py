"""Publishing of live matches to other programs: rows of JSON, over TCP and MQTT."""
