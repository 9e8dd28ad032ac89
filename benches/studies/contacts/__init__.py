"""Public suites of contact simulation, for phipsi and MuJoCo."""
