"""One file per foreign format; their conventions exist nowhere else."""
