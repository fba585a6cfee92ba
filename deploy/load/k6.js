// Load on a server of Tessera by k6 (https://k6.io, 1.0 or newer): each iteration uploads a surface of its own, has it
// remeshed as a job, takes the result and removes what it left.
//
//     k6 run -e TESSERA=127.0.0.1:50051 deploy/load/k6.js                     closed loop, 8 clients
//     k6 run -e TESSERA=127.0.0.1:50051 -e RATE=5 deploy/load/k6.js           open loop, 5 jobs a second
//
// Other variables: CLIENTS (8), DURATION (30s), FACETS (2000), POINTS (200), TENANT, KEY_FILE (a file with a key), TLS (1 for
// TLS), and P99_MS, a threshold on the whole of a job in milliseconds. With a threshold crossed k6 ends with exit code 99.
//
// k6 writes bytes as base64 and 64-bit numbers as text; names of fields are those of JSON.
//
// `tessera load` measures the same and more: it compares its counts with the server's, and counts from the intended start.

import crypto from 'k6/crypto';
import encoding from 'k6/encoding';
import exec from 'k6/execution';
import { Counter, Rate, Trend } from 'k6/metrics';
import grpc from 'k6/net/grpc';

const ADDRESS = __ENV.TESSERA || '127.0.0.1:50051';
const FACETS = Number(__ENV.FACETS || 2000);
const POINTS = Number(__ENV.POINTS || 200);
const CLIENTS = Number(__ENV.CLIENTS || 8);
const DURATION = __ENV.DURATION || '30s';
const KEY = __ENV.KEY_FILE ? open(__ENV.KEY_FILE).trim() : '';
const PIECE_BYTES = 1 << 20;

const closed = { executor: 'constant-vus', vus: CLIENTS, duration: DURATION };
const poured = {
  executor: 'constant-arrival-rate',
  rate: Number(__ENV.RATE || 1),
  duration: DURATION,
  preAllocatedVUs: CLIENTS,
  maxVUs: 16 * CLIENTS,
};

export const options = {
  scenarios: { jobs: __ENV.RATE ? poured : closed },
  thresholds: {
    tessera_failed: ['rate<0.01'],
    ...(__ENV.P99_MS ? { tessera_job: [`p(99)<${__ENV.P99_MS}`] } : {}),
  },
  summaryTrendStats: ['min', 'med', 'p(90)', 'p(99)', 'p(99.9)', 'max'],
};

const whole = new Trend('tessera_job', true);
const upload = new Trend('tessera_upload', true);
const queue = new Trend('tessera_queue', true);
const compute = new Trend('tessera_compute', true);
const download = new Trend('tessera_download', true);
const failed = new Rate('tessera_failed');
const refused = new Counter('tessera_refused');
const facetsDone = new Counter('tessera_facets');

const client = new grpc.Client();
client.load(['../../proto'], 'tessera/v1/job.proto', 'tessera/v1/blob.proto');
let connected = false;

const params = () => {
  const metadata = {};
  if (KEY) metadata.authorization = `Bearer ${KEY}`;
  if (__ENV.TENANT) metadata['tessera-tenant'] = __ENV.TENANT;
  return { metadata, timeout: '120s' };
};

const TABLE = new Uint32Array(256);
for (let n = 0; n < 256; n += 1) {
  let crc = n;
  for (let bit = 0; bit < 8; bit += 1) crc = crc & 1 ? (crc >>> 1) ^ 0x82f63b78 : crc >>> 1;
  TABLE[n] = crc;
}

// CRC-32C (Castagnoli), which the server checks.
function crc32c(bytes) {
  let crc = 0xffffffff;
  for (let at = 0; at < bytes.length; at += 1) crc = TABLE[(crc ^ bytes[at]) & 255] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

// The parts of a PLY file of a torus, without the comment that makes each upload a new blob.
const [head, rest] = (() => {
  const m = Math.max(3, Math.round(Math.sqrt(FACETS / 5)));
  const n = Math.max(3, Math.round(FACETS / 2 / m));
  const lines = [`element vertex ${n * m}`, 'property double x', 'property double y', 'property double z'];
  lines.push(`element face ${2 * n * m}`, 'property list uchar uint vertex_indices', 'end_header');
  const faces = [];
  for (let i = 0; i < n; i += 1) {
    for (let j = 0; j < m; j += 1) {
      const [u, v] = [(2 * Math.PI * i) / n, (2 * Math.PI * j) / m];
      const r = 1 + 0.4 * Math.cos(v);
      lines.push(`${r * Math.cos(u)} ${r * Math.sin(u)} ${0.4 * Math.sin(v)}`);
      const at = (a, b) => (a % n) * m + (b % m);
      faces.push(`3 ${at(i, j)} ${at(i + 1, j)} ${at(i + 1, j + 1)}`, `3 ${at(i, j)} ${at(i + 1, j + 1)} ${at(i, j + 1)}`);
    }
  }
  return ['ply\nformat ascii 1.0\n', `${lines.concat(faces).join('\n')}\n`];
})();

// The text is ASCII.
function bytesOf(text) {
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at += 1) bytes[at] = text.charCodeAt(at);
  return bytes;
}

// A call with one answer, or an error with its status.
async function ask(method, request) {
  const answer = await client.asyncInvoke(`tessera.v1.${method}`, request, params());
  if (answer.status !== grpc.StatusOK) throw answer.error || { code: answer.status, message: 'no answer' };
  return answer.message;
}

// A stream to its end: what it answers.
function stream(method, requests) {
  return new Promise((resolve, reject) => {
    const answers = [];
    const open = new grpc.Stream(client, `tessera.v1.${method}`, params());
    let lost = null;
    open.on('data', (answer) => answers.push(answer));
    open.on('error', (error) => {
      lost = error;
      reject(error);
    });
    open.on('end', () => (lost ? reject(lost) : resolve(answers)));
    requests.forEach((request) => open.write(request));
    open.end();
  });
}

async function put(bytes) {
  const digest = crypto.sha256(bytes.buffer, 'hex');
  const pieces = [];
  for (let offset = 0; offset < bytes.length; offset += PIECE_BYTES) {
    const data = bytes.slice(offset, offset + PIECE_BYTES);
    pieces.push({
      digest,
      sizeBytes: String(bytes.length),
      offset: String(offset),
      data: encoding.b64encode(data.buffer),
      crc32c: crc32c(data),
      finish: offset + data.length === bytes.length,
    });
  }
  const [stored] = await stream('BlobService/Write', pieces);
  if (!stored || !stored.complete) throw { code: 'WRONG_ANSWER', message: 'the upload is not complete' };
  return digest;
}

const between = (from, to) => new Date(to).getTime() - new Date(from).getTime();

// What refuses now and says when to come again, as a full queue does.
const isRefusal = (error) => error && (error.code === grpc.StatusResourceExhausted || error.code === 8);

export default async function job() {
  if (!connected) {
    client.connect(ADDRESS, { plaintext: !__ENV.TLS });
    connected = true;
  }
  const number = exec.scenario.iterationInTest;
  const blobs = [];
  let id = null;
  try {
    const begin = Date.now();
    const digest = await put(bytesOf(`${head}comment k6 ${begin} ${number}\n${rest}`));
    blobs.push(digest);
    upload.add(Date.now() - begin);
    const remesh = { points: POINTS, seed: String(number) };
    const spec = { mesh: { file: { digest, format: 'MESH_FORMAT_PLY' } }, remesh };
    id = (await ask('JobService/CreateJob', { spec })).job.id;
    await stream('JobService/WatchJob', [{ id }]);
    const { job: ended } = await ask('JobService/GetJob', { id });
    (ended.results || []).forEach((result) => blobs.push(result.digest));
    if (ended.state !== 'JOB_STATE_SUCCEEDED') throw { code: ended.state, message: JSON.stringify(ended.failure) };
    queue.add(between(ended.created, ended.started));
    compute.add(between(ended.started, ended.changed));
    const taken = Date.now();
    const mesh = ended.results.find((result) => result.name === 'mesh');
    await stream('BlobService/Read', [{ digest: mesh.digest }]);
    download.add(Date.now() - taken);
    whole.add(Date.now() - begin);
    facetsDone.add(FACETS);
    failed.add(false);
  } catch (error) {
    if (isRefusal(error)) {
      refused.add(1);
    } else {
      failed.add(true);
      console.error(`iteration ${number}: ${error.code}: ${error.message}`);
    }
  }
  // Nothing stays at the server; what is not there any more need not be removed.
  try {
    if (id) await ask('JobService/DeleteJob', { id });
    for (const digest of blobs) await ask('BlobService/Delete', { digest });
  } catch (error) {
    console.warn(`iteration ${number} left something behind: ${error.message}`);
  }
}
