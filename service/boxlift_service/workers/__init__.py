"""Processes that compute beside the server, and how work gets to them."""
