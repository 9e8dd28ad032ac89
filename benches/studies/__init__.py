"""Studies that compare phipsi with other programs: made in the repository, on the pipeline of the reports that ship in the wheel."""
