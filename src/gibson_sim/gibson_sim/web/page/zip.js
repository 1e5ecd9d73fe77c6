// A ZIP file without compression: images are already compressed.

const TABLE = Uint32Array.from({ length: 256 }, (_, n) => { for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1; return n >>> 0; });

function crc32(data) {
  let c = 0xffffffff;
  for (const byte of data) c = TABLE[(c ^ byte) & 255] ^ (c >>> 8);
  return (c ^ 0xffffffff) >>> 0;
}

function record(size, fields) {
  const view = new DataView(new ArrayBuffer(size));
  for (const [offset, bytes, value] of fields) bytes === 2 ? view.setUint16(offset, value, true) : view.setUint32(offset, value, true);
  return new Uint8Array(view.buffer);
}

// files: [name, Uint8Array] each, less than 4 GB in total.
export function zip(files) {
  const parts = [], entries = [];
  let offset = 0;
  for (const [name, data] of files) {
    const text = new TextEncoder().encode(name), crc = crc32(data), size = data.length;
    // 0x21: 1 January 1980, the earliest date of the format. 0x800: names are UTF-8.
    const common = (at) => [[at, 2, 20], [at + 2, 2, 0x800], [at + 8, 2, 0x21], [at + 10, 4, crc], [at + 14, 4, size], [at + 18, 4, size], [at + 22, 2, text.length]];
    parts.push(record(30, [[0, 4, 0x04034b50], ...common(4)]), text, data);
    entries.push(record(46, [[0, 4, 0x02014b50], [4, 2, 20], ...common(6), [42, 4, offset]]), text);
    offset += 30 + text.length + size;
  }
  const length = entries.reduce((sum, e) => sum + e.length, 0);
  const end = record(22, [[0, 4, 0x06054b50], [8, 2, files.length], [10, 2, files.length], [12, 4, length], [16, 4, offset]]);
  return new Blob([...parts, ...entries, end], { type: 'application/zip' });
}
