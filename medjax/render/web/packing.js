/** The bytes of `text`, base64 of gzip. */
async function unzip(text) {
  const zipped = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const MISSING = -(2 ** 31);

/** Rows of whole numbers over time, in steps of a unit: see packing.py. */
class Table {
  constructor({ rows, times, step, order }, bytes, start) {
    this.rows = rows;
    this.times = times;
    this.step = step;
    this.steps = new Int32Array(rows * times);
    this._unfold(bytes, start);
    for (let round = 0; round < order; round += 1) this._sum();
  }

  /** Number of a row at a time; NaN where there is none. */
  at(row, time) {
    const steps = this.steps[row * this.times + time];
    return steps === MISSING ? NaN : steps * this.step;
  }

  _unfold(bytes, start) {
    const count = this.steps.length;
    for (let i = 0; i < count; i += 1) {
      const place = start + i;
      const folded =
        bytes[place] |
        (bytes[place + count] << 8) |
        (bytes[place + 2 * count] << 16) |
        (bytes[place + 3 * count] << 24);
      this.steps[i] = (folded >>> 1) ^ -(folded & 1);
    }
  }

  _sum() {
    const { steps, times } = this;
    for (let row = 0; row < this.rows; row += 1) {
      for (let i = row * times + 1; i < (row + 1) * times; i += 1) steps[i] += steps[i - 1];
    }
  }
}

/** All tables of an episode by name. */
async function unpack(index, text) {
  const bytes = await unzip(text);
  const tables = {};
  let start = 0;
  for (const entry of index) {
    tables[entry.name] = new Table(entry, bytes, start);
    start += 4 * entry.rows * entry.times;
  }
  return tables;
}
