"""What comes in: forms and msgpack, into shared memory."""
