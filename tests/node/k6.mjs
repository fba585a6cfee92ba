// Promise: the k6 script (deploy/load/k6.js) makes calls that a server takes.
//
// k6 itself is not needed: its modules are stood in for by ones on @grpc/grpc-js that read and write messages as k6 does, bytes as
// base64 and 64-bit numbers as text. Run by run.sh, which starts a server: k6.mjs ADDRESS

import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { register } from 'node:module';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

import grpc from '@grpc/grpc-js';
import loader from '@grpc/proto-loader';

const script = new URL('../../deploy/load/k6.mjs', import.meta.url);
const added = new Map();
const add = (name, value) => added.set(name, [...(added.get(name) ?? []), value]);

/** Times as JSON writes them. At a whole second the loader leaves out `nanos`. */
function shown(value) {
  if (Array.isArray(value)) return value.map(shown);
  if (value === null || typeof value !== 'object') return value;
  if (['nanos,seconds', 'seconds'].includes(Object.keys(value).sort().join())) {
    return new Date(Number(value.seconds) * 1000 + (value.nanos ?? 0) / 1e6).toISOString();
  }
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, shown(inner)]));
}

class Metric {
  constructor(name) {
    this.name = name;
  }

  add(value) {
    add(this.name, value);
  }
}

class Client {
  load(folders, ...files) {
    const includeDirs = folders.map((folder) => join(dirname(fileURLToPath(script)), folder));
    const options = { includeDirs, longs: String, enums: String, bytes: String };
    this.definition = grpc.loadPackageDefinition(loader.loadSync(files, options));
  }

  connect(address, { plaintext }) {
    assert.equal(plaintext, true);
    this.address = address;
    this.services = {};
  }

  /** The method of a service, and what it is called on. */
  method(path, { metadata }) {
    const [, service, name] = /^tessera\.v1\.(\w+)\/(\w+)$/.exec(path);
    this.services[service] ??= new this.definition.tessera.v1[service](this.address, grpc.credentials.createInsecure());
    const sent = new grpc.Metadata();
    Object.entries(metadata).forEach(([key, value]) => sent.set(key, value));
    return { client: this.services[service], call: this.services[service][name].bind(this.services[service]), sent };
  }

  asyncInvoke(path, request, params) {
    const { call, sent } = this.method(path, params);
    return new Promise((resolve) => {
      call(request, sent, (error, message) => resolve({ status: error ? error.code : 0, message: shown(message), error }));
    });
  }

  close() {
    Object.values(this.services).forEach((client) => client.close());
  }
}

/** A stream begins with its first message, whatever sides of it are streams. */
class Stream {
  constructor(client, path, params) {
    const { client: service, sent } = client.method(path, params);
    const method = service[path.split('/')[1]];
    const call = method.bind(service);
    this.listeners = {};
    this.requests = [];
    setImmediate(() => {
      const emit = (event, value) => this.listeners[event]?.(value);
      const one = (error, message) => {
        if (error) emit('error', error);
        else emit('data', shown(message));
        emit('end');
      };
      if (method.requestStream && !method.responseStream) {
        const open = call(sent, one);
        this.requests.forEach((request) => open.write(request));
        open.end();
      } else {
        const open = call(this.requests[0], sent);
        open.on('data', (message) => emit('data', shown(message)));
        open.on('error', (error) => emit('error', error));
        open.on('end', () => emit('end'));
      }
    });
  }

  on(event, listener) {
    this.listeners[event] = listener;
  }

  write(request) {
    this.requests.push(request);
  }

  end() {}
}

globalThis.__ENV = { TESSERA: process.argv[2], FACETS: '1000', POINTS: '100', TENANT: 'k6' };
globalThis.k6 = {
  'k6/crypto': { sha256: (bytes, form) => createHash('sha256').update(Buffer.from(bytes)).digest(form) },
  'k6/encoding': { b64encode: (bytes) => Buffer.from(bytes).toString('base64') },
  'k6/execution': { scenario: { iterationInTest: 7 } },
  'k6/metrics': { Counter: Metric, Rate: Metric, Trend: Metric },
  'k6/net/grpc': { Client, Stream, StatusOK: 0, StatusResourceExhausted: 8 },
};

// Imports of k6's modules become these.
const hooks = `export async function resolve(name, context, next) {
  if (!name.startsWith('k6')) return next(name, context);
  const names = { 'k6/metrics': ['Counter', 'Rate', 'Trend'] }[name] ?? [];
  const own = names.map((n) => 'export const ' + n + ' = module.' + n + ';').join('');
  const source = 'const module = globalThis.k6[' + JSON.stringify(name) + ']; export default module;' + own;
  return { url: 'data:text/javascript,' + encodeURIComponent(source), shortCircuit: true };
}`;
register(`data:text/javascript,${encodeURIComponent(hooks)}`);

const opened = [];
const { connect } = Client.prototype;
Client.prototype.connect = function remember(...all) {
  opened.push(this);
  connect.apply(this, all);
};
const { default: job, options } = await import(script);
assert.equal(options.scenarios.jobs.executor, 'constant-vus');
await job();
await job();
assert.deepEqual(added.get('tessera_failed'), [false, false]);
assert.deepEqual(added.get('tessera_facets'), [1000, 1000]);
for (const name of ['tessera_job', 'tessera_upload', 'tessera_queue', 'tessera_compute', 'tessera_download']) {
  const times = added.get(name);
  assert.ok(times.length === 2 && times.every((time) => time >= 0 && time < 60_000), `${name}: ${times}`);
}
// Nothing is left.
const { message } = await opened[0].asyncInvoke('tessera.v1.JobService/ListJobs', {}, { metadata: { 'tessera-tenant': 'k6' } });
assert.equal((message.jobs ?? []).length, 0);
opened.forEach((client) => client.close());
console.log(`k6 script: ${added.get('tessera_job').map((ms) => `${ms} ms`).join(', ')}`);
