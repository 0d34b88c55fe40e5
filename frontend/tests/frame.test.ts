import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { decodeFrame } from "../src/live/frame";
import { FRAME } from "../src/wire";

/** Encodes a frame as the server does. */
function encoded(columns: number[][], kind: number = FRAME.kinds.live): ArrayBuffer {
  const rows = columns[0]?.length ?? 0;
  const buffer = new ArrayBuffer(FRAME.header_bytes + columns.length * rows * 4);
  const view = new DataView(buffer);
  Array.from(FRAME.magic).forEach((char, i) => view.setUint8(FRAME.offsets.magic + i, char.charCodeAt(0)));
  view.setUint8(FRAME.offsets.kind, kind);
  view.setUint16(FRAME.offsets.columns, columns.length, true);
  view.setUint32(FRAME.offsets.rows, rows, true);
  view.setUint32(FRAME.offsets.sequence, 7, true);
  view.setFloat64(FRAME.offsets.first_tick, 2 ** 40, true);
  view.setFloat64(FRAME.offsets.newest_ms, 123.5, true);
  columns.flat().forEach((value, i) => view.setFloat32(FRAME.header_bytes + 4 * i, value, true));
  return buffer;
}

describe("decodeFrame", () => {
  it("reads the header and each column", () => {
    const { columns, ...header } = decodeFrame(encoded([[1, NaN, 3], [4, 5, 6]]));
    assert.deepEqual(header, { history: false, sequence: 7, firstTick: 2 ** 40, rows: 3, newestMs: 123.5 });
    assert.deepEqual(columns.map((column) => [...column]), [[1, NaN, 3], [4, 5, 6]]);
  });

  it("tells history from live samples", () => {
    assert.equal(decodeFrame(encoded([[1]], FRAME.kinds.history)).history, true);
  });

  it("refuses what is no frame", () => {
    const good = encoded([[1, 2]]);
    assert.throws(() => decodeFrame(good.slice(0, FRAME.header_bytes - 1)), /no header/);
    assert.throws(() => decodeFrame(good.slice(0, good.byteLength - 4)), /bytes, not/);
    new DataView(good).setUint8(FRAME.offsets.magic, 0);
    assert.throws(() => decodeFrame(good), /not a sample frame/);
  });
});
