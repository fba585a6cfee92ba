"""A small client of Tessera's jobs and blobs, to copy from. Needs grpcio, google-crc32c and the stubs:

    python -m grpc_tools.protoc -I proto --python_out=. --grpc_python_out=. proto/tessera/v1/*.proto

A mesh is uploaded once and named by its digest; jobs name it, and go on whether or not anybody is connected.
"""

import hashlib
import time

import google_crc32c
import grpc
from tessera.v1 import blob_pb2, blob_pb2_grpc, job_pb2, job_pb2_grpc, remesh_pb2

PIECE_BYTES = 1 << 20
ENDED = ("JOB_STATE_SUCCEEDED", "JOB_STATE_FAILED", "JOB_STATE_CANCELLED", "JOB_STATE_EXPIRED")


class JobFailed(Exception):
    """The job has ended, and has no result."""


def remesh(digest, points, *, format="ply", **options):
    """A remesh of a mesh file that is stored. Options are the fields of RemeshOptions."""
    work = remesh_pb2.RemeshOptions(points=points, **options)
    file = job_pb2.MeshFile(digest=digest, format=job_pb2.MeshFormat.Value(f"MESH_FORMAT_{format.upper()}"))
    return job_pb2.JobSpec(mesh=job_pb2.JobMesh(file=file), remesh=work)


class Jobs:
    """Everything that a tenant does with jobs. Without a tenant, jobs belong to the caller's address."""

    def __init__(self, address, tenant=None):
        self.channel = grpc.insecure_channel(address)
        self.jobs = job_pb2_grpc.JobServiceStub(self.channel)
        self.blobs = blob_pb2_grpc.BlobServiceStub(self.channel)
        self.metadata = [("tessera-tenant", tenant)] if tenant else []

    def close(self):
        self.channel.close()

    def put(self, data):
        """Stores bytes, or goes on with an upload that was cut; gives their digest."""
        digest = hashlib.sha256(data).hexdigest()
        if not self.blobs.FindMissing(blob_pb2.FindMissingRequest(digests=[digest]), metadata=self.metadata).digests:
            return digest
        try:
            asked = blob_pb2.QueryWriteStatusRequest(digest=digest, size_bytes=len(data))
            start = self.blobs.QueryWriteStatus(asked, metadata=self.metadata).kept_bytes
        except grpc.RpcError as error:
            if error.code() != grpc.StatusCode.NOT_FOUND:
                raise
            start = 0
        stored = self.blobs.Write(self.pieces(data, digest, start), metadata=self.metadata)
        assert stored.complete
        return digest

    @staticmethod
    def pieces(data, digest, start=0, end=None):
        """The messages of an upload from byte `start` on; with `end`, it stops there and does not finish."""
        stop = len(data) if end is None else end
        offsets = range(start, stop, PIECE_BYTES) or [start]
        for offset in offsets:
            piece = data[offset : min(offset + PIECE_BYTES, stop)]
            last = end is None and offset + len(piece) == len(data)
            crc = google_crc32c.value(piece)
            yield blob_pb2.WriteRequest(
                digest=digest, size_bytes=len(data), offset=offset, data=piece, crc32c=crc, finish=last
            )

    def read(self, digest):
        """The bytes of a blob."""
        answers = self.blobs.Read(blob_pb2.ReadRequest(digest=digest), metadata=self.metadata)
        data = b"".join(answer.data for answer in answers)
        assert hashlib.sha256(data).hexdigest() == digest, "damaged on its way"
        return data

    def submit(self, spec, request_id=""):
        """Creates a job; gives its name. The same request_id with the same spec gives the same job."""
        created = self.jobs.CreateJob(
            job_pb2.CreateJobRequest(spec=spec, request_id=request_id), metadata=self.metadata
        )
        return created.job.id

    def get(self, job):
        return self.jobs.GetJob(job_pb2.GetJobRequest(id=job), metadata=self.metadata).job

    def watch(self, job, after=0, tries=5):
        """Events after a number, to the end of the job. A lost connection is made again."""
        while True:
            try:
                asked = job_pb2.WatchJobRequest(id=job, after=after)
                for answer in self.jobs.WatchJob(asked, metadata=self.metadata):
                    after = answer.event.number
                    yield answer.event
                return
            except grpc.RpcError as error:
                tries -= 1
                if error.code() != grpc.StatusCode.UNAVAILABLE or tries == 0:
                    raise
                time.sleep(0.5)

    def wait(self, job):
        """Waits for the end of a job; gives the digests of its result by name."""
        for _ in self.watch(job):
            pass
        job = self.get(job)
        state = job_pb2.JobState.Name(job.state)
        if state != "JOB_STATE_SUCCEEDED":
            raise JobFailed(f"{state}: {job.failure.message or job.expired_by}")
        return {blob.name: blob.digest for blob in job.results}
