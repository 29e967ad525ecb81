"""Live matching with a camera on a line: links, protocols, health, and the localiser.

`links` provide and read bytes, `protocols` decode them, `session` matches the events, `odometer`
reads the robot's odometer, and `bridge` imitates a camera.
"""
