"""Devices: serial ports, and the vectors and tables for tests of a device."""
