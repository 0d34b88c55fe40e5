import type uPlot from "uplot";
import type { Hello } from "../wire";
import type { Parameter } from "./traces";

type Range = [number, number];

/** How a chart's vertical axis is laid out. */
export interface VerticalScale {
  logarithmic: boolean;
  range: (dataMin: number | null, dataMax: number | null) => Range;
  label: (value: number) => string;
  /** Formats the value under the cursor. */
  readout: (value: number) => string;
  splits?: (min: number, max: number) => number[];
}

const short = (value: number): string => Number(value.toPrecision(3)).toString();

/** From just below zero to the next half newton above threshold and data. It grows only: a run keeps its scale. */
function force(hello: Hello): VerticalScale {
  let [low, high] = [-0.1, hello.lowest_threshold_n];
  return {
    logarithmic: false,
    range: (min, max) => {
      [low, high] = [Math.min(low, min ?? 0), Math.max(high, max ?? 0)];
      return [stepDown(low, 0.1), stepUp(high * 1.06, 0.5)];
    },
    label: (n) => n.toFixed(1),
    readout: (n) => n.toFixed(2),
  };
}

const displacement: VerticalScale = {
  logarithmic: false,
  range: (min, max) => [stepDown(Math.min(-1e-4, min ?? 0), 1e-4), stepUp(Math.max(1e-3, (max ?? 0) * 1.06), 1e-3)],
  label: (m) => short(m * 1000),
  readout: (m) => (m * 1000).toFixed(2),
};

const probability: VerticalScale = {
  logarithmic: false,
  range: () => [-0.04, 1.04],
  label: (share) => (share * 100).toFixed(0),
  readout: (share) => (share * 100).toFixed(0),
  splits: () => [0, 0.25, 0.5, 0.75, 1],
};

/** NIS of filters that fit, up to where they have lost the grasp. */
const NIS_RANGE = [0.1, 100];

/** Whole decades around the library and the estimates. Diverging estimates leave the chart; they do not stretch it. */
const parameter = (hello: Hello, which: Exclude<Parameter, "force_n">): VerticalScale => {
  const library = which === "nis" ? NIS_RANGE : hello.library.tissues.map((tissue) => tissue[which]);
  const low = Math.min(...library);
  const high = Math.max(...library);
  return {
    logarithmic: true,
    range: (min, max) => [
      10 ** Math.floor(Math.log10(Math.max(Math.min(low, min ?? low), low / 10))),
      10 ** Math.ceil(Math.log10(Math.min(Math.max(high, max ?? high), high * 10) * 0.999)),
    ],
    label: short,
    readout: short,
    splits: decades,
  };
};

/** Zero and all values of the chart of another signal. */
const linear: VerticalScale = {
  logarithmic: false,
  range: (min, max) => {
    const [low, high] = [Math.min(0, min ?? 0), Math.max(0, max ?? 0)];
    const margin = 0.06 * (high - low || 1);
    return [low - margin, high + margin];
  },
  label: short,
  readout: short,
};

export function verticalScale(chart: string, hello: Hello, which: Parameter): VerticalScale {
  if (chart === "force") return force(hello);
  if (chart === "displacement") return displacement;
  if (chart === "probability") return probability;
  if (chart !== "parameter") return linear;
  return which === "force_n" ? force(hello) : parameter(hello, which);
}

/** Converts the scale to uPlot's form. */
export const toUplotScale = (scale: VerticalScale): uPlot.Scale => ({
  // oxlint-disable-next-line typescript/no-unsafe-enum-assignment -- uPlot's enum exists in its types only
  distr: scale.logarithmic ? 3 : 1,
  range: (_chart, min, max) => scale.range(min, max),
});

function decades(min: number, max: number): number[] {
  const first = Math.round(Math.log10(min));
  return Array.from({ length: Math.round(Math.log10(max)) - first + 1 }, (_, i) => 10 ** (first + i));
}

const stepUp = (value: number, step: number): number => Math.ceil(value / step - 1e-9) * step;
const stepDown = (value: number, step: number): number => Math.floor(value / step + 1e-9) * step;
