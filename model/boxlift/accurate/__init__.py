"""The preset `accurate`: the paper's fits, with repairs to what goes in and to what is chosen afterwards.

Prompts are taken near to far. For each: proposals (clusters x headings, and the prompt with the ground
alone), the best of them fitted by the paper's losses with size and heading frozen, polished, weighed by
the evidence. What a chosen box explains is not offered again.
"""

from boxlift.accurate.labels import label_accurately

__all__ = ["label_accurately"]
