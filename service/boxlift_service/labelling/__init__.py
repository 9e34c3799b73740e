"""POST /label, from its parts to its answer."""
