"""What people said about the boxes of a label set: kept beside them, laid over them on request."""
