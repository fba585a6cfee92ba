// A small client of Tessera in JavaScript, to copy from. Needs @grpc/grpc-js and @grpc/proto-loader; there are no stubs to make.

import { createHash } from 'node:crypto';
import { fileURLToPath } from 'node:url';

import grpc from '@grpc/grpc-js';
import loader from '@grpc/proto-loader';

const PROTO = fileURLToPath(new URL('../../proto', import.meta.url));
const CHUNK_BYTES = 64 << 10;
const PIECE_BYTES = 1 << 20;

const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let bit = 0; bit < 8; bit += 1) n = n & 1 ? (n >>> 1) ^ 0x82f63b78 : n >>> 1;
  return n;
});

/** CRC-32C (Castagnoli), which every chunk and every piece carries. */
export function crc32c(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) crc = TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

/** The messages of an array, in chunks. */
function* chunks(kind, array) {
  const bytes = Buffer.from(array.buffer, array.byteOffset, array.byteLength);
  for (let offset = 0; offset < bytes.length; offset += CHUNK_BYTES) {
    const data = bytes.subarray(offset, offset + CHUNK_BYTES);
    yield { chunk: { kind, offset, data, crc32c: crc32c(data) } };
  }
}

/** The messages of a call, to its end. */
async function answers(call) {
  const all = [];
  for await (const message of call) all.push(message);
  return all;
}

export class Tessera {
  constructor(address, { tenant } = {}) {
    const files = ['remesh', 'job', 'blob', 'server'].map((name) => `tessera/v1/${name}.proto`);
    const options = { includeDirs: [PROTO], longs: Number, enums: String, defaults: true, oneofs: true };
    const { RemeshService, JobService, BlobService, ServerService } =
      grpc.loadPackageDefinition(loader.loadSync(files, options)).tessera.v1;
    const open = (Service) => new Service(address, grpc.credentials.createInsecure());
    this.streams = open(RemeshService);
    this.jobs = open(JobService);
    this.blobs = open(BlobService);
    this.server = open(ServerService);
    this.metadata = new grpc.Metadata();
    if (tenant) this.metadata.set('tessera-tenant', tenant);
  }

  close() {
    for (const client of [this.streams, this.jobs, this.blobs, this.server]) client.close();
  }

  /** A call with one answer. */
  ask(client, method, request) {
    return new Promise((resolve, reject) => {
      client[method](request, this.metadata, (error, answer) => (error ? reject(error) : resolve(answer)));
    });
  }

  /** Remeshes a surface over a stream: Float64Array of positions, Uint32Array of facets. */
  async remesh(positions, facets, points, options = {}) {
    const call = this.streams.remesh(this.metadata);
    const mesh = { vertices: positions.length / 3, facets: facets.length / 3, positionType: 'POSITION_TYPE_F64' };
    call.write({ header: { mesh, options: { points, seed: 1, ...options } } });
    for (const message of chunks('ARRAY_KIND_POSITIONS', positions)) call.write(message);
    for (const message of chunks('ARRAY_KIND_FACETS', facets)) call.write(message);
    call.write({ finish: {} });
    call.end();
    const arrays = {};
    let done;
    for await (const { chunk, done: last } of call) {
      done = last ?? done;
      if (!chunk) continue;
      if (crc32c(chunk.data) !== chunk.crc32c) throw new Error(`${chunk.kind}: a chunk is damaged`);
      arrays[chunk.kind] = Buffer.concat([arrays[chunk.kind] ?? Buffer.alloc(0), chunk.data]);
    }
    const copy = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
    return {
      positions: new Float64Array(copy(arrays.ARRAY_KIND_POSITIONS)),
      facets: new Uint32Array(copy(arrays.ARRAY_KIND_FACETS)),
      done,
    };
  }

  /** Stores bytes; their digest. */
  put(bytes) {
    const digest = createHash('sha256').update(bytes).digest('hex');
    return new Promise((resolve, reject) => {
      const call = this.blobs.write(this.metadata, (error, answer) => (error ? reject(error) : resolve(answer.digest)));
      for (let offset = 0; offset < bytes.length; offset += PIECE_BYTES) {
        const data = bytes.subarray(offset, offset + PIECE_BYTES);
        const finish = offset + data.length === bytes.length;
        call.write({ digest, sizeBytes: bytes.length, offset, data, crc32c: crc32c(data), finish });
      }
      call.end();
    });
  }

  /** The bytes of a blob. */
  async read(digest) {
    const pieces = await answers(this.blobs.read({ digest }, this.metadata));
    return Buffer.concat(pieces.map((piece) => piece.data));
  }

  /** Has a file that is stored remeshed as a job; the digests of its result by name. */
  async job(digest, points) {
    const file = { digest, format: 'MESH_FORMAT_PLY' };
    const spec = { mesh: { file }, remesh: { points } };
    const { id } = (await this.ask(this.jobs, 'createJob', { spec })).job;
    await answers(this.jobs.watchJob({ id }, this.metadata));
    const { job } = await this.ask(this.jobs, 'getJob', { id });
    if (job.state !== 'JOB_STATE_SUCCEEDED') throw new Error(`${job.state}: ${job.failure?.message}`);
    return Object.fromEntries(job.results.map((result) => [result.name, result.digest]));
  }
}
