"""Robustness and accuracy of simulation: the sections of docs/measured/motion-robustness.md, written by
benches/motion_robustness.py.
"""
