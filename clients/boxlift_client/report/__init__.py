"""`boxlift report`: a label set as one HTML file that needs nothing else."""
