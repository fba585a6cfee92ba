"""Calls to a server: `pip install tessera-remesh[service]`.

`Client` blocks, `AsyncClient` is for asyncio. Jobs that are submitted outlive the connection.
"""

try:
    import google.rpc  # noqa: F401
    import google_crc32c  # noqa: F401
    import grpc  # noqa: F401
except ImportError as error:
    raise ImportError(f"{error}; a server is called with the extra: pip install tessera-remesh[service]") from None

from .client import AsyncClient, Client
from .errors import ConnectionLost, JobFailed, ServerError

__all__ = ["AsyncClient", "Client", "ConnectionLost", "JobFailed", "ServerError"]
