"""Sweeps: variants x drives x seeds, on the processes of one machine or on a cluster."""
