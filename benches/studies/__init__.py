"""Studies that compare phipsi with other programs, with the pipeline of the reports in the wheel."""
