"""What a server says when it does not do what was asked."""

from __future__ import annotations

import re
from typing import Any

import grpc
from google.rpc import error_details_pb2, status_pb2

from .._engine import TesseraError


class ServerError(TesseraError):
    """A call failed. `code` is the gRPC status, such as "INVALID_ARGUMENT"."""

    def __init__(self, code: str, message: str, fields: dict[str, str], retry_after: float | None) -> None:
        super().__init__(f"{code}: {message}")
        #: gRPC status code.
        self.code = code
        #: What happened.
        self.message = message
        #: What is wrong with which field of the request.
        self.fields = fields
        #: Seconds after which the same call may succeed; None where it would fail again.
        self.retry_after = retry_after


class JobFailed(TesseraError):
    """A job has ended without a result. `state` is "failed", "cancelled" or "expired"."""

    def __init__(self, job: str, state: str, kind: str, message: str) -> None:
        super().__init__(f"job {job} {state}: {message}" if message else f"job {job} {state}")
        #: Id of the job.
        self.job = job
        #: How it ended.
        self.state = state
        #: What kind of failure it was, such as "bad_input"; empty if it did not fail.
        self.kind = kind
        #: Why.
        self.message = message


class ConnectionLost(ServerError):
    """The server could not be reached, in time or at all."""


# Where options and arrays lie in messages, and the fields that are called otherwise than their keyword.
_OPTION = re.compile(
    r"(?:spec|header)\.(?:(?:remesh|rvd|cvt\.options|arrays|options)\.|mesh\.(?=weights|edge_lengths|metric)|(?=seeds))"
    r"(?:density\.)?(\w+)(.*)",
    re.DOTALL,
)
_KEYWORDS = {"edge_lengths": "sizes", "source": "density"}


def by_keyword(text: str) -> str:
    """A text that begins with a field of a message, with the keyword in its place."""
    found = _OPTION.match(text)
    return text if found is None else _KEYWORDS.get(found[1], found[1]) + found[2]


def server_error(error: grpc.RpcError) -> ServerError:
    """With the details that the server attached."""
    call: Any = error
    status = call.code()
    fields: dict[str, str] = {}
    retry_after: float | None = None
    for key, value in call.trailing_metadata() or ():
        if key == "grpc-status-details-bin":
            for detail in status_pb2.Status.FromString(value).details:
                bad, retry = error_details_pb2.BadRequest(), error_details_pb2.RetryInfo()
                if detail.Unpack(bad):
                    for violation in bad.field_violations:
                        fields[by_keyword(violation.field)] = by_keyword(violation.description)
                elif detail.Unpack(retry):
                    retry_after = retry.retry_delay.ToTimedelta().total_seconds()
    lost = status == grpc.StatusCode.UNAVAILABLE and retry_after is None
    kind = ConnectionLost if lost or status == grpc.StatusCode.DEADLINE_EXCEEDED else ServerError
    return kind(status.name, by_keyword(call.details() or ""), fields, retry_after)
