// Arrays and facts about them, as `pack.rs` writes them: the length of a JSON header (u32), the header, and arrays at multiples
// of 8 bytes after it, all gzipped.

const ELEMENTS = { f32: Float32Array, f16: Uint16Array, u32: Uint32Array, u16: Uint16Array, u8: Uint8Array, i8: Int8Array };

/** The header of a pack, with its arrays under `arrays`. */
async function openPack(gzipped) {
  const stream = new Blob([gzipped]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const start = Math.ceil((4 + length) / 8) * 8;
  const arrays = {};
  for (const [name, { type, offset, count }] of Object.entries(header.arrays)) {
    arrays[name] = new ELEMENTS[type](buffer, start + offset, count);
  }
  return { ...header, arrays };
}

/** The pack of this name: embedded in the page, or from the server that the page came from. */
async function loadPack(name) {
  const embedded = document.getElementById(`pack-${name}`);
  const from = embedded ? `data:application/octet-stream;base64,${embedded.textContent.trim()}` : `pack/${name}`;
  const response = await fetch(from);
  if (!response.ok) throw new Error(await response.text());
  return openPack(await response.arrayBuffer());
}

/** Numbers of half precision as single precision. */
function singles(halves) {
  const out = new Float32Array(halves.length);
  for (let i = 0; i < halves.length; i++) out[i] = single(halves[i]);
  return out;
}

function single(half) {
  const sign = half & 0x8000 ? -1 : 1;
  const exponent = (half >> 10) & 31;
  const fraction = half & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}
