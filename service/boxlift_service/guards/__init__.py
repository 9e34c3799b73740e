"""Who may ask, how much, and how fast: refusals before anything is computed."""
