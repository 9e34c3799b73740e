"""boxlift's clients: HTTP, batch runs over datasets, and the command line.

    from boxlift_client.client import Client                  # frames over HTTP
    from boxlift_client.async_client import AsyncClient       # the same, to await
    from boxlift_client import LabelJob, label_dataset        # a dataset, by an engine of engines/

Importing this is light; httpx, torch and Open3D load with the engine or the client that needs them.
"""

from boxlift_client.job import FrameReport, LabelJob, Outcome
from boxlift_client.runner import label_dataset
from boxlift_client.summary import RunSummary

__all__ = ["FrameReport", "LabelJob", "Outcome", "RunSummary", "label_dataset"]
