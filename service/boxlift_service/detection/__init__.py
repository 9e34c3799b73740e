"""POST /detect, and the prompts that are found for POST /label."""
