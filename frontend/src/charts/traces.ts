import { looksOf, UNKNOWN_SLOT, type Look } from "../tissues";
import type { Model } from "../live/model";

/** One line of a chart: which column, and how it is told from the others. */
export interface Trace {
  column: number;
  /** What it belongs to: a tissue, which the legend hides in every chart at once, or the tool. */
  key: string;
  ofTissue: boolean;
  name: string;
  mark: string;
  /** CSS custom property of its colour. */
  colour: string;
  dash: number[];
  /** Column of the SD of its logarithm, drawn as a band; -1 where there is none. */
  sdColumn: number;
  /** Whether the vertical scale makes room for it: estimates may run away, measurements may not. */
  scaled: boolean;
}

export type Parameter = "alpha_n" | "beta_per_m" | "damping_kg_per_s";

export interface PlotSpec {
  id: string;
  traces: Trace[];
}

const plain = (model: Model, channel: string, key: string, name: string, colour: string): Trace => ({
  column: model.column(channel),
  key,
  ofTissue: false,
  name,
  mark: "",
  colour,
  dash: [],
  sdColumn: -1,
  scaled: true,
});

const ofTissue = (model: Model, channel: string, look: Look, scaled: boolean): Trace => ({
  column: look.slot === UNKNOWN_SLOT ? model.column(`${channel}_unknown`) : model.column(channel, look.name),
  key: look.name,
  ofTissue: true,
  name: look.title,
  mark: look.mark,
  colour: `--tissue-${look.slot}`,
  dash: [],
  sdColumn: -1,
  scaled,
});

/** The SD of each parameter's logarithm. */
const SD_OF: Record<Parameter, string> = {
  alpha_n: "log_alpha_sd",
  beta_per_m: "log_beta_sd",
  damping_kg_per_s: "log_damping_sd",
};

/** The lines of the four charts, as far as the server's channels go. */
export function plotSpecs(model: Model, parameter: Parameter): PlotSpec[] {
  const looks = looksOf(model.tissues);
  const library = looks.filter((look) => look.slot !== UNKNOWN_SLOT);
  const limit = { ...plain(model, "limit_n", "limit", "limit", "--line-limit"), mark: "limit", dash: [6, 4] };
  const threshold = { ...plain(model, "threshold_n", "threshold", "alarm threshold", "--line-second"), dash: [2, 4] };
  const specs = [
    {
      id: "force",
      traces: [
        plain(model, "jaw_force_n", "raw", "unfiltered", "--line-raw"),
        ...library.map((look) => ofTissue(model, "force_n", look, false)),
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
    { id: "probability", traces: looks.map((look) => ofTissue(model, "probability", look, true)) },
    {
      id: "parameter",
      traces: library.map((look) => ({
        ...ofTissue(model, parameter, look, true),
        sdColumn: model.column(SD_OF[parameter], look.name),
      })),
    },
  ];
  return specs.map(({ id, traces }) => ({ id, traces: traces.filter((trace) => trace.column >= 0) }));
}
