// Promise: a foreign client (@grpc/grpc-js) has a surface remeshed over a stream and as a job, and hears of its errors.
//
// Run by run.sh, which starts a server: test.mjs ADDRESS

import assert from 'node:assert/strict';

import { crc32c, Tessera } from './client.mjs';

/** A torus of 2 n m facets. */
function torus(n, m) {
  const positions = new Float64Array(3 * n * m);
  const facets = new Uint32Array(6 * n * m);
  for (let i = 0; i < n; i += 1) {
    for (let j = 0; j < m; j += 1) {
      const [u, v] = [(2 * Math.PI * i) / n, (2 * Math.PI * j) / m];
      const r = 1 + 0.4 * Math.cos(v);
      positions.set([r * Math.cos(u), r * Math.sin(u), 0.4 * Math.sin(v)], 3 * (i * m + j));
      const at = (a, b) => ((a + n) % n) * m + ((b + m) % m);
      facets.set([at(i, j), at(i + 1, j), at(i + 1, j + 1)], 6 * (i * m + j));
      facets.set([at(i, j), at(i + 1, j + 1), at(i, j + 1)], 6 * (i * m + j) + 3);
    }
  }
  return { positions, facets };
}

function ply({ positions, facets }) {
  const lines = ['ply', 'format ascii 1.0', `element vertex ${positions.length / 3}`];
  lines.push('property double x', 'property double y', 'property double z');
  lines.push(`element face ${facets.length / 3}`, 'property list uchar uint vertex_indices', 'end_header');
  for (let v = 0; v < positions.length; v += 3) lines.push(positions.slice(v, v + 3).join(' '));
  for (let f = 0; f < facets.length; f += 3) lines.push(`3 ${facets.slice(f, f + 3).join(' ')}`);
  return Buffer.from(`${lines.join('\n')}\n`);
}

assert.equal(crc32c(Buffer.from('123456789')), 0xe3069283);
const tessera = new Tessera(process.argv[2], { tenant: 'node' });
const surface = torus(40, 20);

const info = await tessera.ask(tessera.server, 'getServerInfo', {});
assert.ok(info.readiness.ready && info.version, JSON.stringify(info.readiness));

const { positions, facets, done } = await tessera.remesh(surface.positions, surface.facets, 200, { lloyd: 3, newton: 2 });
assert.equal(positions.length, 3 * done.vertices);
assert.equal(facets.length, 3 * done.facets);
assert.ok(done.vertices >= 190 && done.vertices <= 210, `${done.vertices} vertices`);
const radii = Array.from({ length: done.vertices }, (_, v) => {
  const [x, y, z] = positions.subarray(3 * v, 3 * v + 3);
  return Math.hypot(Math.hypot(x, y) - 1, z);
});
assert.ok(radii.every((radius) => Math.abs(radius - 0.4) < 0.05), 'it lies on the torus');
assert.equal(done.topologyChanges.length, 0, `${done.topologyChanges}`);
assert.equal(JSON.parse(done.reportJson).result.euler, 0);
console.log(`stream: ${done.vertices} vertices, ${done.facets} facets, by ${done.backend}`);

const bytes = ply(surface);
const digest = await tessera.put(bytes);
assert.deepEqual(await tessera.read(digest), bytes);
const result = await tessera.job(digest, 150);
const mesh = await tessera.read(result.mesh);
assert.match(mesh.subarray(0, 300).toString('latin1'), /^ply\n[^]*element vertex 1[45]\d\n/);
console.log(`job: ${mesh.length} bytes`);

// What is wrong is said with its field.
const broken = Float64Array.from(surface.positions);
broken[22] = NaN;
await assert.rejects(tessera.remesh(broken, surface.facets, 200), (error) => {
  assert.equal(error.code, 3);
  assert.match(error.details, /vertex 7/);
  assert.ok(error.metadata.get('grpc-status-details-bin').length > 0, 'it has details');
  return true;
});
console.log('errors: as documented');
tessera.close();
