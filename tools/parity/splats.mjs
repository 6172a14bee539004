// Writes the golden files of crates/splat/src/files/golden: four Gaussians in every format, each by the program that the format comes from.
//
//   npm install @adobe/spz@0.2.3 @playcanvas/splat-transform@2.7.1 @mkkellogg/gaussian-splats-3d@0.4.7 three@0.187
//   node splats.mjs main.js ../../crates/splat/src/files/golden
//
// main.js is that of github.com/antimatter15/splat (commit ba182b5); @adobe/spz is nianticlabs/spz compiled for the web. The .ply is by the
// rule below. splat-transform takes -y of a .ply as up and turns by 180 degrees about the z axis on writing .glb; the others turn nothing.

import { execFileSync } from 'node:child_process';
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname, join } from 'node:path';

const [mainJs, out] = process.argv.slice(2);
mkdirSync(out, { recursive: true });

const COUNT = 4;
const REST = 45;
const names = ['x', 'y', 'z', 'nx', 'ny', 'nz', 'f_dc_0', 'f_dc_1', 'f_dc_2']
    .concat(Array.from({ length: REST }, (_, i) => `f_rest_${i}`))
    .concat(['opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3']);
const wave = (i, seed) => Math.fround(Math.sin(12.9898 * (i + 1) + 78.233 * seed));
const value = (name, i) => {
    const number = Number(name.match(/\d+$/) ?? 0);
    if (name === 'x') return i === 0 ? 1500 : wave(i, 1); // 12 fractional bits hold no more than 2048
    if (name === 'y') return wave(i, 2);
    if (name === 'z') return wave(i, 3);
    if (name.startsWith('f_dc')) return 2 * wave(i, 10 + number);
    if (name.startsWith('f_rest')) return 0.7 * wave(i, 20 + number);
    if (name === 'opacity') return 3 * wave(i, 4);
    if (name.startsWith('scale')) return -5 + 2 * wave(i, 5 + number);
    if (name.startsWith('rot')) return wave(i, 90 + number);
    return 0;
};
const rows = Array.from({ length: COUNT }, (_, i) => names.map((name) => Math.fround(value(name, i))));
const header = `ply\nformat binary_little_endian 1.0\nelement vertex ${COUNT}\n${names
    .map((name) => `property float ${name}\n`)
    .join('')}end_header\n`;
const ply = Buffer.concat([Buffer.from(header), Buffer.from(new Float32Array(rows.flat()).buffer)]);
writeFileSync(join(out, 'tiny.ply'), ply);

const source = readFileSync(mainJs, 'utf8');
const start = source.indexOf('function processPlyBuffer(inputBuffer)');
const end = source.indexOf('\n    }\n', start) + 6;
const quiet = { log() {}, time() {}, timeEnd() {} };
const processPlyBuffer = new Function('console', `${source.slice(start, end)}; return processPlyBuffer;`)(quiet);
const copy = ply.buffer.slice(ply.byteOffset, ply.byteOffset + ply.byteLength);
writeFileSync(join(out, 'tiny.splat'), Buffer.from(processPlyBuffer(copy)));

const require = createRequire(join(process.cwd(), 'package.json'));
const spz = await (await import(require.resolve('@adobe/spz'))).default();
const column = (name) => names.indexOf(name);
const gather = (list) => Float32Array.from(rows.flatMap((row) => list.map((name) => row[column(name)])));
const rest = REST / 3;
const byCoefficient = Array.from({ length: REST }, (_, k) => `f_rest_${(k % 3) * rest + Math.floor(k / 3)}`);
const cloud = {
    numPoints: COUNT,
    shDegree: 3,
    antialiased: true,
    extensions: [],
    positions: gather(['x', 'y', 'z']),
    scales: gather(['scale_0', 'scale_1', 'scale_2']),
    rotations: gather(['rot_1', 'rot_2', 'rot_3', 'rot_0']),
    alphas: gather(['opacity']),
    colors: gather(['f_dc_0', 'f_dc_1', 'f_dc_2']),
    sh: gather(byCoefficient),
};
const from = spz.CoordinateSystem.UNSPECIFIED;
for (const version of [2, 3, 4]) {
    const bytes = spz.saveSpzToBuffer(cloud, { version, from, sh1Bits: 5, shRestBits: 4 });
    writeFileSync(join(out, `tiny-v${version}.spz`), Buffer.from(bytes));
}

// The last with records of a camera and of mirrored axes, of which two are exchanged, and what the program reads of it. (It writes no records
// that are made in JavaScript.)
const plain = readFileSync(join(out, 'tiny-v4.spz'));
const records = Buffer.alloc(32);
[0xadbe0002, 12, 0, 0, 0, 0xadbe0003, 4, spz.CoordinateSystem.LFU.value].forEach((word, at) => records.writeUInt32LE(word, 4 * at));
const extended = Buffer.concat([plain.subarray(0, 32), records, plain.subarray(32)]);
extended[14] |= 2;
extended.writeUInt32LE(32 + records.length, 16);
writeFileSync(join(out, 'tiny-v4-lfu.spz'), extended);
const read = spz.loadSpzFromBuffer(extended, { to: spz.CoordinateSystem.RUB });
const lists = [
    [read.positions, ['x', 'y', 'z']],
    [read.scales, ['scale_0', 'scale_1', 'scale_2']],
    [read.rotations, ['rot_1', 'rot_2', 'rot_3', 'rot_0']],
    [read.alphas, ['opacity']],
    [read.colors, ['f_dc_0', 'f_dc_1', 'f_dc_2']],
    [read.sh, byCoefficient],
];
const ofExtended = new Float32Array(COUNT * names.length);
for (const [list, columns] of lists) {
    list.forEach((value, at) => {
        ofExtended[Math.floor(at / columns.length) * names.length + column(columns[at % columns.length])] = value;
    });
}
writeFileSync(join(out, 'tiny-of-v4-lfu.ply'), Buffer.concat([Buffer.from(header), Buffer.from(ofExtended.buffer)]));

// GaussianSplats3D is made for browsers.
globalThis.navigator ??= { userAgent: '' };
globalThis.window ??= globalThis;
const { PlyParser, SplatBufferGenerator } = await import(require.resolve('@mkkellogg/gaussian-splats-3d'));
const { Vector3 } = require('three');
for (const level of [0, 1, 2]) {
    const splats = PlyParser.parseToUncompressedSplatArray(copy, 2);
    const generator = SplatBufferGenerator.getStandardGenerator(1, level, 0, new Vector3(), 5.0, 256);
    const { bufferData } = generator.generateFromUncompressedSplatArray(splats);
    writeFileSync(join(out, `tiny-${level}.ksplat`), Buffer.from(bufferData));
}

const cli = join(dirname(require.resolve('@playcanvas/splat-transform')), '..', 'bin', 'cli.mjs');
execFileSync(process.execPath, [cli, '-w', join(out, 'tiny.ply'), join(out, 'tiny.glb')]);
// And what the program itself reads from compressed files, whose order is another.
for (const [from, to] of [
    ['tiny.ply', 'tiny.compressed.ply'],
    ['tiny.compressed.ply', 'tiny-decompressed.ply'],
    ['tiny.ply', 'tiny.sog'],
    ['tiny.sog', 'tiny-of-sog.ply'],
]) {
    execFileSync(process.execPath, [cli, '-w', '-g', 'cpu', join(out, from), join(out, to)]);
}
