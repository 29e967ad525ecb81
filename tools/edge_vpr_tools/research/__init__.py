"""Comparison of methods: experiments, sweeps, baselines, data sets."""
