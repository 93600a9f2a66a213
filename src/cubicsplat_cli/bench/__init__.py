"""Measurements that anyone can repeat: speed and memory of a step, quality over a folder, ablations."""
