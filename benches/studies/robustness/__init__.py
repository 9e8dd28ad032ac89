"""Measurements of how robust and how accurate simulation is: the sections of docs/motion-robustness.md, made by benches/motion_robustness.py."""
