"""`python -m boxlift_service`: the service, configured by BOXLIFT_* variables alone."""

from boxlift_service.server import run
from boxlift_service.settings import ServiceSettings

if __name__ == "__main__":
    run(ServiceSettings.from_environment())
