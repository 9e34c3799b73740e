"""Label sets on disk: their files, how they were made, and the frames that they are of."""
