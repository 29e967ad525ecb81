"""Live from a serial-attached camera: links, protocols, health, and a localiser that keeps up.

`links` are where bytes come from, `protocols` what they mean, `reader` reads the one while the
other decodes, `live` matches, and `bridge` stands in for a camera.
"""
