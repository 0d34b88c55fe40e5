import { tissueStyles, UNKNOWN_SLOT, type TissueStyle } from "../tissues";
import type { Model } from "../live/model";

/** One line of a chart: its column and its look. */
export interface Trace {
  column: number;
  /** The tissue, whose lines the legend hides in all charts at once, or the name of a line of the tool. */
  key: string;
  ofTissue: boolean;
  name: string;
  mark: string;
  /** CSS custom property of its color. */
  color: string;
  dash: number[];
  /** Column of the SD of its logarithm, drawn as a band; -1 if there is none. */
  sdColumn: number;
  /** Whether the vertical scale includes it. Estimates of force do not count, because they may diverge. */
  scaled: boolean;
}

export type Parameter = "alpha_n" | "beta_per_m" | "damping_kg_per_s";

export interface PlotSpec {
  id: string;
  traces: Trace[];
}

const plain = (model: Model, channel: string, key: string, name: string, color: string): Trace => ({
  column: model.column(channel),
  key,
  ofTissue: false,
  name,
  mark: "",
  color,
  dash: [],
  sdColumn: -1,
  scaled: true,
});

const ofTissue = (model: Model, channel: string, style: TissueStyle, scaled: boolean): Trace => ({
  column: style.slot === UNKNOWN_SLOT ? model.column(`${channel}_unknown`) : model.column(channel, style.name),
  key: style.name,
  ofTissue: true,
  name: style.title,
  mark: style.mark,
  color: `--tissue-${style.slot}`,
  dash: [],
  sdColumn: -1,
  scaled,
});

/** Channel with the SD of each parameter's logarithm. */
const SD_OF: Record<Parameter, string> = {
  alpha_n: "log_alpha_sd",
  beta_per_m: "log_beta_sd",
  damping_kg_per_s: "log_damping_sd",
};

/** Returns the lines of the four charts, for the channels that the server sends. */
export function plotSpecs(model: Model, parameter: Parameter): PlotSpec[] {
  const styles = tissueStyles(model.tissues);
  const library = styles.filter((style) => style.slot !== UNKNOWN_SLOT);
  const limit = { ...plain(model, "limit_n", "limit", "limit", "--line-limit"), mark: "limit", dash: [6, 4] };
  const threshold = { ...plain(model, "threshold_n", "threshold", "alarm threshold", "--line-second"), dash: [2, 4] };
  const specs = [
    {
      id: "force",
      traces: [
        plain(model, "jaw_force_n", "raw", "unfiltered", "--line-raw"),
        ...library.map((style) => ofTissue(model, "force_n", style, false)),
        plain(model, "jaw_force_filtered_n", "filtered", "filtered", "--line-measured"),
        threshold,
        limit,
      ],
    },
    {
      id: "displacement",
      traces: [
        plain(model, "jaw_displacement_m", "raw", "unfiltered", "--line-raw"),
        plain(model, "jaw_displacement_filtered_m", "filtered", "filtered", "--line-measured"),
        { ...plain(model, "tissue_displacement_m", "tissue", "in tissue", "--line-second"), dash: [2, 3] },
      ],
    },
    { id: "probability", traces: styles.map((style) => ofTissue(model, "probability", style, true)) },
    {
      id: "parameter",
      traces: library.map((style) => ({
        ...ofTissue(model, parameter, style, true),
        sdColumn: model.column(SD_OF[parameter], style.name),
      })),
    },
  ];
  return specs.map(({ id, traces }) => ({ id, traces: traces.filter((trace) => trace.column >= 0) }));
}
