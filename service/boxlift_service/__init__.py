"""boxlift as an HTTP service.

    from boxlift_service import ServiceSettings, run

    run(ServiceSettings(port=8000))

Importing this needs pydantic only; FastAPI, uvicorn and torch load when the service starts. The ASGI
application itself is `boxlift_service.app.create_app`.
"""

from boxlift_service.server import run
from boxlift_service.settings import ServiceSettings

__all__ = ["ServiceSettings", "run"]
