"""Devices: serial ports, and the vectors and tables that a device is held against."""
