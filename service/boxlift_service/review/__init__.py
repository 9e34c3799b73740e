"""The review page: label sets opened for people, their queue, and what they say."""
