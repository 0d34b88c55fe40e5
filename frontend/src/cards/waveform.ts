import { createSvg, find, setAttribute, setText } from "../dom";
import { duration, fixed } from "../format";
import type { ProtocolInfo } from "../wire";

const WIDTH = 300;
const HEIGHT = 64;
const MARGIN = 4;

/** Draws the motor command of one cycle of a protocol. */
export function drawWaveform(root: HTMLElement, protocol: ProtocolInfo): void {
  const points = protocol.time_s.map((t, i) => {
    const x = (t / protocol.cycle_s) * WIDTH;
    const y = HEIGHT - MARGIN - ((protocol.command_v[i] ?? 0) / (protocol.peak_command_v || 1)) * (HEIGHT - 2 * MARGIN);
    return `${x.toFixed(1)},${y.toFixed(1)}`;
  });
  const line = createSvg("polyline", { points: points.join(" "), "vector-effect": "non-scaling-stroke" });
  const svg = find(root, "waveform", SVGSVGElement);
  svg.replaceChildren(line);
  if (protocol.peak_command_v === 0 && protocol.refused === null) {
    setAttribute(svg, "aria-label", "No motor command");
    setText(find(root, "waveform-facts"), `No motor: close the jaws by hand as often as you like. It ends after ${duration(protocol.cycle_s * 1000)}.`);
    return;
  }
  const facts = `up to ${fixed(protocol.peak_command_v, 1, "V")}, ${fixed(protocol.cycle_s, 2, "s")} each`;
  setAttribute(svg, "aria-label", `Motor command over one cycle, ${facts}`);
  setText(find(root, "waveform-facts"), `Motor command ${facts}`);
}
