"""What the benchmarks of the running service share: its process, requests, load, and a look into /proc.

Everything here is black-box: a real service on loopback, spoken to by HTTP and looked at from outside.
"""
