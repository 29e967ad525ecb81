"""The hardware core in ``firmware_model/rtl``: its parameters, simulation and size."""
