"""Clients of a server: `Client` blocks, `AsyncClient` is for asyncio."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import grpc
import grpc.aio
import numpy as np
from numpy.typing import ArrayLike

from .. import meshes
from .._engine import InputError
from ..calls import OPTIONS, remesh_options, rvd_options, to_remesh
from ..meshes import Attributes, Surface
from ..progress import Engine, ProgressLike, listener
from ..results import CvtStep, Remesh, Rvd
from . import flows
from ._stubs import job_pb2
from .errors import JobFailed, ServerError, server_error
from .session import steps

#: Bytes of a message; the server's own are 4 MiB at most.
CHANNEL = [("grpc.max_receive_message_length", 16 << 20)]


class _Server:
    """Where a server is, and who asks."""

    def __init__(self, endpoint: str, key: str | None, tenant: str | None, ca: bytes | str | Path | None) -> None:
        url = urlsplit(endpoint)
        if url.scheme not in ("http", "https") or url.hostname is None or url.path not in ("", "/"):
            raise InputError(f"endpoint is {endpoint!r}; http://HOST:PORT or https://HOST:PORT is needed")
        self.secure = url.scheme == "https"
        host = f"[{url.hostname}]" if ":" in url.hostname else url.hostname
        self.target = f"{host}:{url.port or (443 if self.secure else 80)}"
        if key is not None and not self.secure and url.hostname not in ("localhost", "127.0.0.1", "::1"):
            raise InputError("a key is sent over https alone: anybody on the way could read it")
        if ca is not None and not self.secure:
            raise InputError("ca is for https")
        self.ca = Path(ca).read_bytes() if isinstance(ca, (str, Path)) else ca
        self.metadata: list[tuple[str, str]] = []
        if key is not None:
            self.metadata.append(("authorization", f"Bearer {key}"))
        if tenant is not None:
            self.metadata.append(("tessera-tenant", tenant))

    def channel(self, kind: Any) -> Any:
        if self.secure:
            credentials = grpc.ssl_channel_credentials(root_certificates=self.ca)
            return kind.secure_channel(self.target, credentials, options=CHANNEL)
        return kind.insecure_channel(self.target, options=CHANNEL)


def _method(call: Any) -> str:
    return f"/tessera.v1.{call.method}"


class Client:
    """A connection to a server, for any number of calls.

    Calls are repeated where the server says that another try may succeed, and where the connection is lost, for up to
    `patience` seconds without progress. A call that is interrupted cancels its job.

    Args:
        endpoint: "https://HOST:PORT", or "http://HOST:PORT" on this machine.
        key: the key that the server wants, "tsr_...".
        tenant: whose work it is, where several share a server without keys.
        ca: certificates of authorities that sign for the server, PEM: bytes or a path. The system's if None.
        timeout: seconds until a whole call counts as failed; None: no limit.
        patience: seconds to go on trying.
    """

    def __init__(
        self,
        endpoint: str,
        *,
        key: str | None = None,
        tenant: str | None = None,
        ca: bytes | str | Path | None = None,
        timeout: float | None = None,
        patience: float = 60.0,
    ) -> None:
        self._server = _Server(endpoint, key, tenant, ca)
        self._timeout, self._patience = timeout, patience
        self._channel = self._server.channel(grpc)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the connection."""
        self._channel.close()

    def remesh(self, mesh: Any, faces: ArrayLike | None = None, points: float | str | None = None, **options: Any) -> Remesh:
        """As `tessera_remesh.remesh`, by this server."""
        surface, given, carried, progress = _remesh_arguments(mesh, faces, points, options)
        with listener(progress) as listen:
            return self._remesh(surface, given, carried, listen)

    def put(self, data: bytes) -> str:
        """Stores bytes and gives their digest. What is stored already is not sent."""
        return str(self._run(flows.put(data, self._patience)))

    def read(self, digest: str) -> bytes:
        """The bytes of a blob."""
        return bytes(self._run(flows.read(digest, self._patience)))

    def submit(self, mesh: Any, faces: ArrayLike | None = None, points: float | str | None = None, **options: Any) -> str:
        """Begins a remesh as a job that outlives this connection, and gives its id. `result` fetches it.

        The options are those of `remesh`, and two more. `request_id`: the same id with the same job gives the job that is there.
        `reuse`: "same_bits" gives an earlier job with the same result, if there is one; "never" is the default.
        """
        request_id, reuse = str(options.pop("request_id", "")), str(options.pop("reuse", "never"))
        surface, given, carried, _ = _remesh_arguments(mesh, faces, points, options)
        spec = self._run(flows.remesh_spec(surface, given, carried, self._patience))
        return str(self._run(flows.create(spec, request_id, self._patience, reuse)).id)

    def state(self, job: str) -> str:
        """ "queued", "running", "succeeded", "failed", "cancelled" or "expired"."""
        return _state(self._run(flows.get(job, self._patience)))

    def result(self, job: str, progress: ProgressLike = None) -> Remesh:
        """Waits for a job that `submit` began, and gives its remesh.

        Raises:
            JobFailed: it has no result.
        """
        with listener(progress) as listen:
            return to_remesh(_NOBODYS, None, self._run(_fetch(job, listen, self._patience)))

    def cancel(self, job: str) -> None:
        """Cancels a job."""
        self._run(flows.cancel(job, self._patience))

    def delete(self, job: str) -> None:
        """Forgets a job that has ended, and its result."""
        self._run(flows.delete(job, self._patience))

    def _remesh(
        self, surface: Surface, options: dict[str, Any], carried: Attributes | None, listen: Engine | None
    ) -> Remesh:
        started: list[str] = []
        flow = flows.remesh(surface, options, carried, listen, started.append, self._patience)
        return to_remesh(surface, carried, self._job(flow, started))

    def _rvd(self, surface: Surface, options: dict[str, Any]) -> Rvd:
        started: list[str] = []
        return Rvd(**self._job(flows.rvd(surface, options, started.append, self._patience), started))

    def _cvt(self, surface: Surface, options: dict[str, Any], lloyd: int, newton: int) -> Iterator[CvtStep]:
        try:
            yield from steps(self._channel, self._server.metadata, surface, options, lloyd, newton)
        except grpc.RpcError as error:
            raise server_error(error) from None
        finally:
            self.close()

    def _job(self, flow: flows.Flow, started: list[str]) -> Any:
        """A flow that has a job; the job is cancelled if the flow is left."""
        try:
            return self._run(flow)
        except JobFailed:
            raise
        except BaseException:
            self._leave(started)
            raise

    def _leave(self, started: list[str]) -> None:
        for job in started:
            try:
                self._run(flows.cancel(job, 0.0))
            except ServerError:
                pass  # it has ended, or the server is gone

    def _run(self, flow: flows.Flow) -> Any:
        end = None if self._timeout is None else time.monotonic() + self._timeout
        answer: Any = None
        error: ServerError | None = None
        while True:
            try:
                call = flow.send(answer) if error is None else flow.throw(error)
            except StopIteration as done:
                return done.value
            answer, error = None, None
            try:
                answer = self._do(call, None if end is None else max(end - time.monotonic(), 0.0))
            except grpc.RpcError as failed:
                error = server_error(failed)

    def _do(self, call: flows.Call, timeout: float | None) -> Any:
        metadata = self._server.metadata
        if isinstance(call, flows.Sleep):
            time.sleep(call.seconds if timeout is None else min(call.seconds, timeout))
            return None
        read = call.answer.FromString
        if isinstance(call, flows.Unary):
            of = self._channel.unary_unary(_method(call), type(call.request).SerializeToString, read)
            return of(call.request, metadata=metadata, timeout=timeout)
        if isinstance(call, flows.Upload):
            of = self._channel.stream_unary(_method(call), lambda request: request.SerializeToString(), read)
            return of(call.requests(), metadata=metadata, timeout=timeout)
        of = self._channel.unary_stream(_method(call), type(call.request).SerializeToString, read)
        stream = of(call.request, metadata=metadata, timeout=timeout)
        try:
            for message in stream:
                call.hear(message)
        finally:
            stream.cancel()
        return None


class AsyncClient:
    """The same for asyncio: every call is awaited, and a task that is cancelled cancels its job."""

    def __init__(
        self,
        endpoint: str,
        *,
        key: str | None = None,
        tenant: str | None = None,
        ca: bytes | str | Path | None = None,
        timeout: float | None = None,
        patience: float = 60.0,
    ) -> None:
        self._server = _Server(endpoint, key, tenant, ca)
        self._timeout, self._patience = timeout, patience
        self._channel: Any = None

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Ends the connection."""
        if self._channel is not None:
            await self._channel.close()

    async def remesh(
        self, mesh: Any, faces: ArrayLike | None = None, points: float | str | None = None, **options: Any
    ) -> Remesh:
        """As `tessera_remesh.remesh`, by this server."""
        surface, given, carried, progress = _remesh_arguments(mesh, faces, points, options)
        started: list[str] = []
        with listener(progress) as listen:
            flow = flows.remesh(surface, given, carried, listen, started.append, self._patience)
            return to_remesh(surface, carried, await self._job(flow, started))

    async def rvd(self, mesh: Any, faces: ArrayLike | None = None, **options: Any) -> Rvd:
        """As `tessera_remesh.rvd`, by this server."""
        surface = meshes.surface(mesh, faces)
        given = {"seeds": None, "points": None, "seed": None, "weights": None, "pieces": True, **options}
        given = rvd_options(surface, given)
        started: list[str] = []
        return Rvd(**await self._job(flows.rvd(surface, given, started.append, self._patience), started))

    async def put(self, data: bytes) -> str:
        """Stores bytes and gives their digest."""
        return str(await self._run(flows.put(data, self._patience)))

    async def read(self, digest: str) -> bytes:
        """The bytes of a blob."""
        return bytes(await self._run(flows.read(digest, self._patience)))

    async def submit(self, mesh: Any, faces: ArrayLike | None = None, points: float | str | None = None, **options: Any) -> str:
        """As `Client.submit`."""
        request_id, reuse = str(options.pop("request_id", "")), str(options.pop("reuse", "never"))
        surface, given, carried, _ = _remesh_arguments(mesh, faces, points, options)
        spec = await self._run(flows.remesh_spec(surface, given, carried, self._patience))
        return str((await self._run(flows.create(spec, request_id, self._patience, reuse))).id)

    async def state(self, job: str) -> str:
        """As `Client.state`."""
        return _state(await self._run(flows.get(job, self._patience)))

    async def result(self, job: str, progress: ProgressLike = None) -> Remesh:
        """As `Client.result`."""
        with listener(progress) as listen:
            return to_remesh(_NOBODYS, None, await self._run(_fetch(job, listen, self._patience)))

    async def cancel(self, job: str) -> None:
        """Cancels a job."""
        await self._run(flows.cancel(job, self._patience))

    async def delete(self, job: str) -> None:
        """Forgets a job that has ended, and its result."""
        await self._run(flows.delete(job, self._patience))

    async def _job(self, flow: flows.Flow, started: list[str]) -> Any:
        try:
            return await self._run(flow)
        except JobFailed:
            raise
        except BaseException:
            for job in started:
                try:
                    await asyncio.shield(self._run(flows.cancel(job, 0.0)))
                except ServerError:
                    pass
            raise

    async def _run(self, flow: flows.Flow) -> Any:
        if self._channel is None:
            # Here, because it belongs to the loop that runs.
            self._channel = self._server.channel(grpc.aio)
        end = None if self._timeout is None else time.monotonic() + self._timeout
        answer: Any = None
        error: ServerError | None = None
        while True:
            try:
                call = flow.send(answer) if error is None else flow.throw(error)
            except StopIteration as done:
                return done.value
            answer, error = None, None
            try:
                answer = await self._do(call, None if end is None else max(end - time.monotonic(), 0.0))
            except grpc.RpcError as failed:
                error = server_error(failed)

    async def _do(self, call: flows.Call, timeout: float | None) -> Any:
        metadata = self._server.metadata
        if isinstance(call, flows.Sleep):
            await asyncio.sleep(call.seconds if timeout is None else min(call.seconds, timeout))
            return None
        read = call.answer.FromString
        if isinstance(call, flows.Unary):
            of = self._channel.unary_unary(_method(call), type(call.request).SerializeToString, read)
            return await of(call.request, metadata=metadata, timeout=timeout)
        if isinstance(call, flows.Upload):
            of = self._channel.stream_unary(_method(call), lambda request: request.SerializeToString(), read)
            return await of(call.requests(), metadata=metadata, timeout=timeout)
        of = self._channel.unary_stream(_method(call), type(call.request).SerializeToString, read)
        stream = of(call.request, metadata=metadata, timeout=timeout)
        try:
            async for message in stream:
                call.hear(message)
        finally:
            stream.cancel()
        return None


#: Of a job whose surface is not known here.
_NOBODYS = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), None, "arrays")


def _remesh_arguments(
    mesh: Any, faces: ArrayLike | None, points: float | str | None, options: dict[str, Any]
) -> tuple[Surface, dict[str, Any], Attributes | None, ProgressLike]:
    surface = meshes.surface(mesh, faces)
    progress: ProgressLike = options.pop("progress", None)
    for name in options:
        # Threads are of this process.
        if name not in OPTIONS or name == "threads":
            raise TypeError(f"there is no argument {name}")
    taken, carried = remesh_options(surface, {**OPTIONS, "points": points, **options})
    return surface, taken, carried, progress


def _state(job: Any) -> str:
    return str(job_pb2.JobState.Name(job.state)).removeprefix("JOB_STATE_").lower()


def _fetch(job: str, listen: Engine | None, patience: float) -> flows.Flow:
    yield from flows.watch(job, flows.teller(listen), patience)
    digests = yield from flows.result(job, patience)
    blobs = {}
    for name, digest in digests.items():
        blobs[name] = yield from flows.read(digest, patience)
    return flows.remesh_arrays(blobs)


