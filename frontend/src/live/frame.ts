import { FRAME } from "../wire";

/** Samples of consecutive ticks: one array per channel, in the order of `Hello.channels`. NaN is a missing value. */
export interface Frame {
  history: boolean;
  sequence: number;
  firstTick: number;
  rows: number;
  newestMs: number;
  columns: Float32Array[];
}

const MAGIC = Array.from(FRAME.magic, (char) => char.charCodeAt(0));

/** Decodes a binary frame without copying its samples. Throws if the bytes are no frame. */
export function decodeFrame(buffer: ArrayBuffer): Frame {
  if (buffer.byteLength < FRAME.header_bytes) throw new Error(`frame of ${buffer.byteLength} bytes has no header`);
  const view = new DataView(buffer);
  const at = FRAME.offsets;
  if (MAGIC.some((code, i) => view.getUint8(at.magic + i) !== code)) throw new Error("not a sample frame");
  const columnCount = view.getUint16(at.columns, true);
  const rows = view.getUint32(at.rows, true);
  const expected = FRAME.header_bytes + columnCount * rows * Float32Array.BYTES_PER_ELEMENT;
  if (buffer.byteLength !== expected) throw new Error(`frame has ${buffer.byteLength} bytes, not ${expected}`);
  const bytesPerColumn = rows * Float32Array.BYTES_PER_ELEMENT;
  return {
    history: view.getUint8(at.kind) === FRAME.kinds.history,
    sequence: view.getUint32(at.sequence, true),
    firstTick: view.getFloat64(at.first_tick, true),
    rows,
    newestMs: view.getFloat64(at.newest_ms, true),
    columns: Array.from(
      { length: columnCount },
      (_, i) => new Float32Array(buffer, FRAME.header_bytes + i * bytesPerColumn, rows),
    ),
  };
}
