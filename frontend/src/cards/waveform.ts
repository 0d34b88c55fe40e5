import { find, setAttribute, setText } from "../dom";
import { fixed } from "../format";
import type { ProtocolInfo } from "../wire";

const WIDTH = 300;
const HEIGHT = 64;
const MARGIN = 4;
const SVG = "http://www.w3.org/2000/svg";

/** Draws the motor command of one cycle of a protocol. */
export function drawWaveform(root: HTMLElement, protocol: ProtocolInfo): void {
  const points = protocol.time_s.map((t, i) => {
    const x = (t / protocol.cycle_s) * WIDTH;
    const y = HEIGHT - MARGIN - ((protocol.command_v[i] ?? 0) / protocol.peak_command_v) * (HEIGHT - 2 * MARGIN);
    return `${x.toFixed(1)},${y.toFixed(1)}`;
  });
  const line = document.createElementNS(SVG, "polyline");
  line.setAttribute("points", points.join(" "));
  line.setAttribute("vector-effect", "non-scaling-stroke");
  const svg = find(root, "waveform", SVGSVGElement);
  svg.replaceChildren(line);
  const facts = `up to ${fixed(protocol.peak_command_v, 1, "V")}, ${fixed(protocol.cycle_s, 2, "s")} each`;
  setAttribute(svg, "aria-label", `Motor command over one cycle, ${facts}`);
  setText(find(root, "waveform-facts"), `Motor command ${facts}`);
}
