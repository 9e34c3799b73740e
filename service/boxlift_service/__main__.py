"""`python -m boxlift_service`: the service, configured by BOXLIFT_* variables alone."""

import sys

from boxlift.errors import BoxliftError
from boxlift_service.server import run
from boxlift_service.settings import ServiceSettings

if __name__ == "__main__":
    try:
        run(ServiceSettings.from_environment())
    except BoxliftError as error:
        sys.exit(f"error: {error}")
