"""Live matching with a camera on a line: links, protocols, health, and the localiser.

`links` provide bytes, `link_reader` reads them, `protocols` decode them, `live` matches the events,
and `bridge` imitates a camera.
"""
